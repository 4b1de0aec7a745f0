"""From a map to a floor plan: walls, openings, rooms and furniture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.plan.faces import Face, dominant_direction, find_faces, find_surfaces, snap_directions
from gridslam.plan.openings import Opening, find_openings
from gridslam.plan.rasters import BoolArray, Raster, dilate, erode, fill_polygons, make_raster
from gridslam.plan.rooms import LEAST_AREA_M2, Room, find_rooms
from gridslam.plan.surfaces import SurfacePoints, points_of_grid
from gridslam.plan.untyped import ndimage, require_map_extra
from gridslam.plan.walls import Wall, close_corners, drop_clutter, find_furniture_faces, hull, join_faces, make_walls
from gridslam.types import FloatArray, OccupancyGrid

_BESIDE_M = 0.25
_LEAST_BESIDE = 0.2
_SLIT_CELLS = 2
"""Strips up to twice as narrow are no floor where they are free, and no gap in it where they are unknown."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class FloorPlan:
    """A floor plan, in the frame of the map.

    Attributes
    ----------
    walls : tuple of Wall
    openings : tuple of Opening
        Doors and wider openings.
    rooms : tuple of Room
        Those that were entered first, of these the largest.
    furniture : tuple of (K, 2) float64, m
        Outlines of what stands in rooms, anticlockwise.
    faces : tuple of Face
        The surfaces that walls were made from.
    dominant_rad : float, rad, [-pi/4, pi/4)
        Direction in or across which most walls run.
    """

    walls: tuple[Wall, ...]
    openings: tuple[Opening, ...]
    rooms: tuple[Room, ...]
    furniture: tuple[FloatArray, ...]
    faces: tuple[Face, ...]
    dominant_rad: float


def make_plan(grid: OccupancyGrid, points: SurfacePoints | None = None, path: FloatArray | None = None) -> FloorPlan:
    """Find walls, openings, rooms and furniture in a map.

    Parameters
    ----------
    grid : OccupancyGrid
        Its occupied cells are surfaces where there are no points; its free cells are the floor.
    points : SurfacePoints, optional
        Of the scans that the map was made from, in its frame: exacter than cells.
    path : (P, 2) float64, m, optional
        Where the laser was, by which rooms that were entered are known.

    Raises
    ------
    MissingDependencyError
        shapely or contourpy is not installed; the extra ``map`` brings them.
    """
    require_map_extra()
    raster = make_raster(grid)
    points = points_of_grid(grid) if points is None else points.select(~raster.is_vacated(points.positions))
    found = [face for surface in find_surfaces(points) for face in find_faces(surface)]
    dominant = dominant_direction(found)
    joined = snap_directions(drop_clutter(join_faces(found, raster)), dominant)
    is_furniture, against_walls = find_furniture_faces(joined, raster)
    faces = [face for face, is_other in zip(joined, is_furniture, strict=True) if not is_other]
    walls = close_corners(make_walls(faces))
    floor = _close_floor(raster, [wall.outline for wall in walls], against_walls)
    openings = find_openings(floor, raster, walls, points)
    rooms = find_rooms(floor, raster, faces, openings, path)
    furniture = [*_outline_furniture(raster), *against_walls]
    near = _find_near_floor(floor, raster)
    return FloorPlan(
        tuple(wall for wall in walls if near(wall.outline)),
        tuple(openings),
        tuple(rooms),
        tuple(outline for outline in furniture if near(outline)),
        tuple(faces),
        dominant,
    )


def _find_near_floor(floor: BoolArray, raster: Raster) -> Callable[[FloatArray], bool]:
    """Return whether a fifth of an outline lies beside floor of 2 m² and more: the rest was seen through a window."""
    labels, _ = ndimage.label(floor)
    is_large = np.bincount(labels.reshape(-1)) * raster.cell_m**2 >= LEAST_AREA_M2
    is_large[0] = False
    near = dilate(is_large[labels], round(_BESIDE_M / raster.cell_m))

    def is_near(outline: FloatArray) -> bool:
        sides = zip(outline, np.roll(outline, -1, axis=0), strict=True)
        places = [np.linspace(a, b, 2 + int(np.hypot(*(b - a)) / _BESIDE_M)) for a, b in sides]
        return float(near[raster.cells(np.concatenate(places))].mean()) >= _LEAST_BESIDE

    return is_near


def _close_floor(raster: Raster, walls: list[FloatArray], furniture: list[FloatArray]) -> BoolArray:
    """Find floor (H, W): free, or beneath furniture, or between the beams of a sparse scan; no walls, no slits."""
    floor = raster.floor | fill_polygons(raster, furniture)
    blocked = (raster.occupied & ~floor) | fill_polygons(raster, walls)
    floor = (floor | erode(dilate(floor, _SLIT_CELLS), _SLIT_CELLS)) & ~blocked
    return dilate(erode(floor, _SLIT_CELLS), _SLIT_CELLS) & ~blocked


def _outline_furniture(raster: Raster) -> list[FloatArray]:
    """Return the convex outlines (K, 2) of isolated objects."""
    labels, _ = ndimage.label(raster.furniture, np.ones((3, 3)))
    outlines = []
    for number, part in enumerate(ndimage.find_objects(labels), start=1):
        cells = np.argwhere(labels[part] == number) + np.array([part[0].start, part[1].start])
        if not raster.occupied[tuple(cells.T)].any() or len(cells) * raster.cell_m**2 < 0.02:
            continue
        half = raster.cell_m / 2
        corners = raster.points(cells)[:, None] + half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        outlines.append(hull(corners.reshape(-1, 2)))
    return outlines
