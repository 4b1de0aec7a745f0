"""Planar rigid motions and angles; everything works on arrays and knows nothing of robots."""

from gridslam.geometry import angles, se2

__all__ = ["angles", "se2"]
