"""A floor plan drawn to scale: rooms, walls, doors and furniture, with dimensions, a scale bar and a title."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gridslam.plan.floor_plan import FloorPlan
from gridslam.plan.rooms import Room
from gridslam.plan.sheet import Mark, Sheet
from gridslam.types import FloatArray
from gridslam.viz.canvas import Colour, round_length

_INK: Colour = (20, 24, 32)
_QUIET: Colour = (110, 118, 130)
_FLOOR: Colour = (247, 244, 236)
_GLIMPSED: Colour = (232, 240, 246)
_PIECE: Colour = (236, 230, 216)
_DOOR: Colour = (0, 105, 190)
_OPEN: Colour = (225, 120, 0)
_MARGIN_MM = 28.0
_LETTERS_MM = 2.6
_FACE_MM = 0.5
_LONGEST_BAR_MM = 50.0
_SHORTEST_ROOM_LABEL_MM = 8.0


def draw_plan(plan: FloorPlan, name: str, scale: int) -> Sheet:
    """Draw a plan at 1:`scale`.

    Parameters
    ----------
    plan : FloorPlan
    name : str
        Title of the sheet.
    scale : int, >= 1
        100 for 1:100: 1 m is 10 mm.
    """
    per_m = 1000.0 / scale
    low, high = plan.bounds
    size = (high - low) * per_m + 2 * _MARGIN_MM
    size[0] = max(size[0], 2 * _MARGIN_MM + 60.0)
    sheet = Sheet((float(size[0]), float(size[1])), f"{name}, 1:{scale}")

    def place(points: FloatArray) -> FloatArray:
        return np.asarray((points - low) * per_m + _MARGIN_MM)

    marks = sheet.marks
    for room in plan.rooms:
        floor = _GLIMPSED if room.is_entered is False else _FLOOR
        marks.append(Mark("rooms", place(room.outline), fill=floor, closed=True))
        marks += [Mark("rooms", place(hole), fill=(255, 255, 255), closed=True) for hole in room.holes]
    for outline in plan.furniture:
        marks.append(Mark("furniture", place(outline), _PIECE, _QUIET, 0.13, closed=True))
    for room in plan.rooms:
        marks += [Mark("unknown", place(side), None, _OPEN, 0.35, dashed=True) for side in room.unknown]
    for wall in plan.walls:
        if wall.thickness_m is None:
            marks.append(Mark("walls", place(wall.ends), None, _INK, _FACE_MM))
        else:
            marks.append(Mark("walls", place(wall.outline), _INK, _INK, 0.13, closed=True))
    for opening in plan.openings:
        marks.append(Mark("doors", place(opening.ends), None, _DOOR, 0.25))
        where = place(opening.ends).mean(axis=0) + 2.0 * opening.normal
        marks.append(Mark("doors", where[None], _DOOR, None, 1.8, text=f"{opening.width_m:.2f}"))
    for room in plan.rooms:
        marks += _label(room, place)
    marks += _dimensions(high - low, per_m)
    marks += _foot(sheet, name, scale, per_m)
    return sheet


def _label(room: Room, place: Callable[[FloatArray], FloatArray]) -> list[Mark]:
    """Name, area, and width and depth of a room, where they have room."""
    if np.ptp(place(room.outline), axis=0).min() < _SHORTEST_ROOM_LABEL_MM:
        return []
    at = place(room.label_point[None])
    width, depth = np.ptp(room.outline, axis=0)
    lines = [room.name, f"{room.area_m2:.1f} m\u00b2", f"{width:.2f} x {depth:.2f} m"]
    return [
        Mark(
            "text", at + np.array([[0, (1 - k) * 1.35 * _LETTERS_MM]]), _INK if k < 2 else _QUIET, None, size, text=text
        )
        for k, (text, size) in enumerate(zip(lines, (_LETTERS_MM, _LETTERS_MM, 2.0), strict=True))
    ]


def _dimensions(extent: FloatArray, per_m: float) -> list[Mark]:
    """Width below and height to the left of the plan, with ticks at their ends."""
    marks = []
    for axis in (0, 1):
        length = extent[axis] * per_m
        ends = np.full((2, 2), _MARGIN_MM - 7.0)
        ends[:, axis] = _MARGIN_MM, _MARGIN_MM + length
        marks.append(Mark("dimensions", ends, None, _QUIET, 0.18))
        for end in ends:
            marks.append(Mark("dimensions", end + np.array([[-0.9, -0.9], [0.9, 0.9]]), None, _QUIET, 0.3))
        middle = ends.mean(axis=0) + ([0, 2.2] if axis == 0 else [-2.2, 0])
        text = f"{extent[axis]:.2f} m"
        marks.append(Mark("dimensions", middle[None], _QUIET, None, _LETTERS_MM, text=text, upright=axis == 1))
    return marks


def _foot(sheet: Sheet, name: str, scale: int, per_m: float) -> list[Mark]:
    """Title on top, and a scale bar below that is 20 to 50 mm long."""
    length = round_length(_LONGEST_BAR_MM / per_m)
    width, height = sheet.size_mm
    ends = np.array([[_MARGIN_MM, 10.0], [_MARGIN_MM + length * per_m, 10.0]])
    edges = [end + np.array([[0, -1.0], [0, 1.0]]) for end in ends]
    title = np.array([[width / 2, height - 10.0]])
    return [
        Mark("title", title, _INK, None, 4.0, text=f"{name}   1:{scale}"),
        Mark("title", ends, None, _INK, 0.35),
        *(Mark("title", edge, None, _INK, 0.35) for edge in edges),
        Mark("title", ends.mean(axis=0)[None] - [[0, 3.0]], _INK, None, _LETTERS_MM, text=f"{length:g} m"),
    ]
