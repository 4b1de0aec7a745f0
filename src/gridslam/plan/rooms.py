"""Rooms: the floor between walls and openings, as polygons whose sides are the walls' faces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeAlias, final

import numpy as np

from gridslam.plan.faces import Face
from gridslam.plan.openings import Opening
from gridslam.plan.rasters import BoolArray, Raster, fill_polygons
from gridslam.plan.segments import Segments
from gridslam.plan.untyped import ndimage, require_map_extra
from gridslam.types import FloatArray

LEAST_AREA_M2 = 2.0
_LEAST_ENCLOSED = 0.2
_SMALLEST_HOLE_M2 = 0.3
_SIMPLE_M = 0.12
_SNAP_M = 0.2
_SNAP_RAD = np.deg2rad(10)
_LEAST_SIDE_M = 0.3
_CUT_CORNER_M = 0.45
_Line: TypeAlias = tuple[FloatArray, FloatArray, bool]
"""A point of it, its direction, and whether it is that of a wall or an opening."""


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
        _, shapely = require_map_extra()
        polygon = shapely.Polygon(self.outline, self.holes)
        middle = shapely.maximum_inscribed_circle(polygon, tolerance=0.1).coords[0]
        return np.array(middle)


def find_rooms(
    floor: BoolArray,
    raster: Raster,
    faces: Sequence[Face],
    openings: Sequence[Opening],
    path: FloatArray | None = None,
) -> list[Room]:
    """Cut the floor at the openings; each part of 2 m² and more with walls about it is a room, the largest first.

    With the positions (P, 2) of the robot rooms that it has only looked into follow those that were entered.
    """
    bars = [_extend(opening.ends, 2 * raster.cell_m) for opening in openings]
    cut = floor & ~fill_polygons(raster, bars)
    labels, _ = ndimage.label(cut)
    entered = None if path is None else np.unique(labels[raster.cells(path)])
    sides = _sides_of(faces, openings)
    rooms = []
    sizes = np.bincount(labels.reshape(-1)) * raster.cell_m**2
    for number, part in enumerate(ndimage.find_objects(labels), start=1):
        if sizes[number] >= LEAST_AREA_M2:
            window = tuple(slice(max(0, s.start - 1), s.stop + 1) for s in part)
            mask = labels[window] == number
            corner = raster.origin + np.array([window[1].start, window[0].start]) * raster.cell_m
            room = _make_room(mask, corner, raster, sides)
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
    _, shapely = require_map_extra()
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


def _sides_of(faces: Sequence[Face], openings: Sequence[Opening]) -> Segments:
    """Sides that rooms may have, free space to their left: faces, and openings from both sides."""
    sides = [face.ends for face in faces]
    for opening in openings:
        aside = 0.5 * opening.thickness_m * opening.normal
        sides += [opening.ends + aside, (opening.ends - aside)[::-1]]
    return Segments.of(np.array(sides))


def _make_room(mask: BoolArray, corner: FloatArray, raster: Raster, sides: Segments) -> Room | None:
    """Polygon of a part of the floor; None where too little of its outline is wall or opening."""
    contourpy, shapely = require_map_extra()
    filled = _fill_small_holes(mask, raster.cell_m)
    generator = contourpy.contour_generator(
        z=np.pad(filled, 1).astype(np.float64), fill_type=contourpy.FillType.OuterOffset
    )
    points, offsets = generator.filled(0.5, 2.0)
    pieces = []
    for xy, cuts in zip(points, offsets, strict=True):
        rings = [(corner + (xy[a:b] - 0.5) * raster.cell_m) for a, b in pairwise(cuts)]
        pieces.append(shapely.Polygon(rings[0], rings[1:]))
    traced = shapely.simplify(max(pieces, key=lambda piece: piece.area), _SIMPLE_M)
    if traced.is_empty or traced.geom_type != "Polygon":
        return None
    rings = [_snap(np.array(ring.coords)[:-1], sides) for ring in (traced.exterior, *traced.interiors)]
    polygon = shapely.make_valid(shapely.Polygon(rings[0], [ring for ring in rings[1:] if len(ring) >= 3]))
    if polygon.geom_type != "Polygon":
        parts = [part for part in getattr(polygon, "geoms", ()) if part.geom_type == "Polygon"]
        polygon = max(parts, key=lambda part: part.area, default=traced)
    polygon = shapely.geometry.polygon.orient(polygon)
    outline = np.array(polygon.exterior.coords)[:-1]
    unknown, share = _find_unknown(outline, raster, sides)
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


def _snap(ring: FloatArray, sides: Segments) -> FloatArray:
    """Move the sides of a ring (K, 2) onto walls' faces and openings near them, and its corners to where they meet.

    A short side between two that were moved is a corner which the cells have cut off.
    """
    ends = np.roll(ring, -1, axis=0)
    lines = [_match(begin, end, sides) for begin, end in zip(ring, ends, strict=True)]
    count = len(ring)
    kept = [
        k
        for k in range(count)
        if lines[k][2]
        or np.hypot(*(ends[k] - ring[k])) > _CUT_CORNER_M
        or not (lines[k - 1][2] and lines[(k + 1) % count][2])
    ]
    corners: list[FloatArray] = []
    for before, after in zip([kept[-1], *kept], kept, strict=False):
        corner = (ends[before] + ring[after]) / 2
        meeting = _meet(lines[before], lines[after])
        if meeting is not None and np.hypot(*(meeting - corner)) < 2 * _SNAP_M:
            corners.append(meeting)
        else:
            corners += [place + ((corner - place) @ along) * along for place, along, _ in (lines[before], lines[after])]
    return _drop_repeated(np.array(corners))


def _meet(first: _Line, second: _Line) -> FloatArray | None:
    """Where two lines meet; None where they are parallel to 20 degrees."""
    turn = first[1][0] * second[1][1] - first[1][1] * second[1][0]
    if abs(turn) < np.sin(np.deg2rad(20)):
        return None
    apart = second[0] - first[0]
    return np.asarray(first[0] + (apart[0] * second[1][1] - apart[1] * second[1][0]) / turn * first[1])


def _drop_repeated(ring: FloatArray) -> FloatArray:
    """Remove corners that repeat the previous one or are on the line between their neighbours."""
    while len(ring) > 3:
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        first, second = ring - before, after - ring
        cross = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
        flat = (cross < 0.01 * np.hypot(*(after - before).T)) | (np.hypot(*first.T) < 0.01)
        if not flat.any():
            break
        ring = np.delete(ring, np.argmax(flat), axis=0)
    return ring


def _match(begin: FloatArray, end: FloatArray, sides: Segments) -> _Line:
    """Point and direction of the side of a wall or an opening that a side of a ring is; its own if there is none."""
    length = float(np.hypot(*(end - begin)))
    along = (end - begin) / max(length, 1e-9)
    if length >= _LEAST_SIDE_M:
        _, sides = sides.near(np.array([begin, end]), _SNAP_M + length * np.tan(_SNAP_RAD))
        middle = (begin + end) / 2
        offsets = np.abs(((middle - sides.ends[:, 0]) * sides.normals).sum(axis=1))
        steps, _ = sides.locate(begin, along)
        overlaps = np.minimum(steps.max(axis=1), length) - np.maximum(steps.min(axis=1), 0)
        fits = (sides.alongs @ along > np.cos(_SNAP_RAD)) & (offsets < _SNAP_M) & (overlaps > 0.3 * length)
        if fits.any():
            chosen = int(np.argmax(np.where(fits, overlaps, -np.inf)))
            return sides.ends[chosen, 0], sides.alongs[chosen], True
    return begin, along, False


def _find_unknown(outline: FloatArray, raster: Raster, sides: Segments) -> tuple[FloatArray, float]:
    """Parts (U, 2, 2) of an outline without anything occupied, wall or opening near, and their share of its length."""
    unknown, hidden, total = [], 0.0, 0.0
    for begin, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        _, beside = sides.near(np.array([begin, end]), 0.1)
        along = end - begin
        length = float(np.hypot(*along))
        total += length
        count = max(1, round(length / 0.1))
        places = begin + np.outer((np.arange(count) + 0.5) / count, along)
        is_known = raster.beside_occupied[raster.cells(places)] | (
            beside.distances(places).min(axis=1, initial=np.inf) < 0.05
        )
        edges = np.flatnonzero(np.diff(np.concatenate([[True], is_known, [True]]).astype(np.int8)))
        for first, last in zip(edges[::2], edges[1::2], strict=True):
            hidden += (last - first) / count * length
            if (last - first) / count * length >= _LEAST_SIDE_M:
                unknown.append(begin + np.outer([first / count, last / count], along))
    return np.array(unknown).reshape(-1, 2, 2), hidden / max(total, 1e-9)
