"""From a map to a floor plan: walls, doors, rooms, and files that other programs take."""

from gridslam.plan.floor_plan import FloorPlan, make_plan
from gridslam.plan.openings import Opening
from gridslam.plan.rooms import Room
from gridslam.plan.segments import Segments
from gridslam.plan.surfaces import SurfacePoints, points_of_scans
from gridslam.plan.walls import Wall

__all__ = [
    "FloorPlan",
    "Opening",
    "Room",
    "Segments",
    "SurfacePoints",
    "Wall",
    "make_plan",
    "points_of_scans",
]
