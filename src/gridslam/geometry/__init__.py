"""Rigid motions of the plane and of space, and angles; nothing here knows of robots."""

from gridslam.geometry import angles, rigid, se2

__all__ = ["angles", "rigid", "se2"]
