"""Rooms: the floor between walls and openings, as polygons."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from gridslam.plan.openings import Opening
from gridslam.plan.rasters import BoolArray, Raster, dilate, fill_polygons
from gridslam.plan.untyped import ndimage, require_map_extra
from gridslam.types import FloatArray

LEAST_AREA_M2 = 2.0
_LEAST_ENCLOSED = 0.2
_SMALLEST_HOLE_M2 = 0.3
_SIMPLE_M = 0.12
_STEP_M = 0.1
_LEAST_SIDE_M = 0.3


@final
@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A room, or the part of it that was seen.

    Attributes
    ----------
    name : str
    outline : (K, 2) float64, m
        Corners, anticlockwise, the first not repeated.
    holes : tuple of (K, 2) float64, m
        Pillars and cores, clockwise.
    unknown : (U, 2, 2) float64, m
        Sides of the outline where nothing was seen: the room continues there, or a wall was hidden.
    area_m2 : float
        With what furniture stands on.
    is_entered : bool or None
        Whether the robot was in it, and has not only looked in through a door; None where its path is not known.
    """

    name: str
    outline: FloatArray
    holes: tuple[FloatArray, ...]
    unknown: FloatArray
    area_m2: float
    is_entered: bool | None = None

    @property
    def label_point(self) -> FloatArray:
        """A point (2,) well inside, m: where a label has most room."""
        shapely = require_map_extra()
        polygon = shapely.Polygon(self.outline, self.holes)
        return np.array(shapely.maximum_inscribed_circle(polygon, tolerance=0.1).coords[0])


def find_rooms(
    floor: BoolArray, raster: Raster, openings: Sequence[Opening], path: FloatArray | None = None
) -> list[Room]:
    """Cut the floor at the openings; each part of 2 m² and more with walls about it is a room, the largest first.

    With the positions (P, 2) of the robot rooms that it has only looked into follow those that were entered.
    """
    bars = fill_polygons(raster, [_extend(opening.ends, 2 * raster.cell_m) for opening in openings])
    bounds = dilate(raster.occupied | bars, 2)
    labels, _ = ndimage.label(floor & ~bars)
    entered = None if path is None else np.unique(labels[raster.cells(path)])
    rooms = []
    sizes = np.bincount(labels.reshape(-1)) * raster.cell_m**2
    for number, part in enumerate(ndimage.find_objects(labels), start=1):
        if sizes[number] >= LEAST_AREA_M2:
            corner = raster.origin + np.array([part[1].start, part[0].start]) * raster.cell_m
            room = _make_room(labels[part] == number, corner, raster, bounds)
            if room is not None:
                rooms.append(replace(room, is_entered=None if entered is None else bool(np.isin(number, entered))))
    rooms.sort(key=lambda room: -room.area_m2)
    looked_into = [room for room in rooms if room.is_entered is False]
    rooms = [room for room in rooms if room.is_entered is not False]
    return [
        *(replace(room, name=f"room {k}") for k, room in enumerate(rooms, start=1)),
        *(replace(room, name=f"not entered {k}") for k, room in enumerate(looked_into, start=1)),
    ]


def name_rooms(rooms: Sequence[Room], names: Sequence[tuple[str, FloatArray]]) -> tuple[Room, ...]:
    """Give rooms the names at places (2,) in them; the last of several names."""
    shapely = require_map_extra()
    named = {
        k: name
        for name, place in names
        for k, room in enumerate(rooms)
        if shapely.Polygon(room.outline, room.holes).contains(shapely.Point(place))
    }
    return tuple(replace(room, name=named.get(k, room.name)) for k, room in enumerate(rooms))


def _extend(ends: FloatArray, by_m: float) -> FloatArray:
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    return ends + np.outer([-by_m, by_m], along)


def _make_room(mask: BoolArray, corner: FloatArray, raster: Raster, bounds: BoolArray) -> Room | None:
    """Polygon of a part of the floor; None where too little of its outline is wall or opening."""
    shapely = require_map_extra()
    edges = np.diff(np.pad(_fill_small_holes(mask, raster.cell_m), ((0, 0), (1, 1))).astype(np.int8))
    row, first = np.nonzero(edges > 0)
    last = np.nonzero(edges < 0)[1]
    low, high = (corner + raster.cell_m * np.column_stack(cells) for cells in ((first, row), (last, row + 1)))
    floor = shapely.union_all(shapely.box(*low.T, *high.T))
    # The face of a wall is in the cells after the floor's last ones: on average half a cell further.
    wide = shapely.simplify(floor, _SIMPLE_M).buffer(raster.cell_m / 2, join_style="mitre")
    polygon = shapely.geometry.polygon.orient(max(getattr(wide, "geoms", [wide]), key=lambda piece: piece.area))
    outline = np.array(polygon.exterior.coords)[:-1]
    unknown, share = _find_unknown(outline, raster, bounds)
    if polygon.area < LEAST_AREA_M2 or 1 - share < _LEAST_ENCLOSED:
        return None
    holes = tuple(np.array(ring.coords)[:-1] for ring in polygon.interiors)
    return Room("", outline, holes, unknown, float(polygon.area))


def _fill_small_holes(mask: BoolArray, cell_m: float) -> BoolArray:
    """Fill holes that are no pillar, but cells that nothing was seen of."""
    holes, _ = ndimage.label(np.pad(~mask, 1, constant_values=True))  # the margin joins all that is outside
    small = np.bincount(holes.reshape(-1)) * cell_m**2 < _SMALLEST_HOLE_M2
    small[[0, holes[0, 0]]] = False
    return np.asarray(mask | small[holes[1:-1, 1:-1]], np.bool_)


def _find_unknown(outline: FloatArray, raster: Raster, bounds: BoolArray) -> tuple[FloatArray, float]:
    """Parts (U, 2, 2) of an outline beside no wall or opening, whose cells are `bounds`, and their share of it."""
    unknown, hidden, total = [], 0.0, 0.0
    for begin, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        length = float(np.hypot(*(end - begin)))
        total += length
        count = max(1, round(length / _STEP_M))
        is_known = bounds[raster.cells(begin + np.outer((np.arange(count) + 0.5) / count, end - begin))]
        edges = np.flatnonzero(np.diff(np.concatenate([[True], is_known, [True]]).astype(np.int8)))
        for part in edges.reshape(-1, 2) / count:
            hidden += length * (part[1] - part[0])
            if length * (part[1] - part[0]) >= _LEAST_SIDE_M:
                unknown.append(begin + np.outer(part, end - begin))
    return np.array(unknown).reshape(-1, 2, 2), hidden / max(total, 1e-9)
