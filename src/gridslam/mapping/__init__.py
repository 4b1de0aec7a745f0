"""Mapping with known poses."""

from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping

__all__ = ["OccupancyGridMapping"]
