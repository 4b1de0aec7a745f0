"""Pictures of maps and trajectories."""

from gridslam.viz.picture import draw_map

__all__ = ["draw_map"]
