"""Doors and openings: gaps between the ends of walls, with floor in them and on both sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.plan.rasters import BoolArray, Raster
from gridslam.plan.segments import Segments
from gridslam.plan.surfaces import SurfacePoints
from gridslam.plan.walls import Wall
from gridslam.types import FloatArray

_NARROWEST_M = 0.5
_WIDEST_M = 2.6
_WIDEST_DOOR_M = 1.4
_WIDEST_TO_SIDE_M = 1.6
"""Between a wall's end and the side of another one: beyond it is a corridor's width."""
_JAMB_M = 0.06
_REACH_M = 0.2
"""Behind the ends of walls jambs are looked for within this distance."""
_SHORTEST_FACE_M = 0.6
_UNSEEN_M = 0.06
"""Behind a wall's only seen face: a wall is thicker than this."""
_ASIDE_M = 0.25
_PARALLEL_RAD = np.deg2rad(6)
_CROSSING_RAD = np.deg2rad(45)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Opening:
    """A door or a wider opening between the ends of walls.

    Attributes
    ----------
    ends : (2, 2) float64, m
        Where its jambs are, on the middle of the wall.
    thickness_m : float
        Of the wall; 0 where it is not known.
    """

    ends: FloatArray
    thickness_m: float

    @property
    def width_m(self) -> float:
        """Clear width."""
        return float(np.hypot(*(self.ends[1] - self.ends[0])))

    @property
    def normal(self) -> FloatArray:
        """Unit vector (2,) through the opening."""
        along = (self.ends[1] - self.ends[0]) / max(self.width_m, 1e-9)
        return np.array([-along[1], along[0]])

    @property
    def kind(self) -> str:
        """ "door" up to 1.4 m, "opening" beyond."""
        return "door" if self.width_m <= _WIDEST_DOOR_M else "opening"


def find_openings(floor: BoolArray, raster: Raster, walls: Sequence[Wall], points: SurfacePoints) -> list[Opening]:
    """Find where a wall ends and continues, or meets another one, 0.5 to 2.6 m further, with floor between."""
    openings: list[Opening] = []
    segments = Segments.of(np.array([wall.ends for wall in walls]))
    halves = np.array([0.5 * (wall.thickness_m or 0.0) for wall in walls])
    for k in sorted(range(len(walls)), key=lambda k: (walls[k].thickness_m is None, -walls[k].length_m)):
        if walls[k].thickness_m is None and walls[k].length_m < _SHORTEST_FACE_M:
            continue
        for start, along in ((walls[k].ends[1], segments.alongs[k]), (walls[k].ends[0], -segments.alongs[k])):
            gap = _find_gap(k, start, along, segments, halves)
            if gap is None or not _is_passage(start, along, gap, floor, raster):
                continue
            near = points.tree.query_ball_point(start + gap / 2 * along, gap / 2 + _ASIDE_M + _REACH_M)
            opening = _measure(walls[k], start, along, gap, points.select(np.array(near, np.int64)))
            if opening.width_m >= _NARROWEST_M and not any(_is_same(opening, known) for known in openings):
                openings.append(opening)
    return openings


def _find_gap(k: int, start: FloatArray, along: FloatArray, segments: Segments, halves: FloatArray) -> float | None:
    """How far from an end of wall `k` the next one in a direction is; None where that is no opening's width."""
    numbers, segments = segments.near(np.array([start, start + _WIDEST_M * along]), _ASIDE_M)
    steps, offsets = segments.locate(start, along)
    turns = np.abs(segments.normals @ along)
    ahead = (turns < np.sin(_PARALLEL_RAD)) & (np.abs(offsets).min(axis=1) < _ASIDE_M) & (steps.max(axis=1) > 0.1)
    crossing = (turns > np.sin(_CROSSING_RAD)) & (offsets.min(axis=1) < _ASIDE_M) & (offsets.max(axis=1) > -_ASIDE_M)
    shares = np.clip(-offsets[:, 0] / np.where(crossing, offsets[:, 1] - offsets[:, 0], 1.0), 0, 1)
    sides = steps[:, 0] + shares * (steps[:, 1] - steps[:, 0]) - halves[numbers]
    gaps = np.where(ahead, steps.min(axis=1), np.where(crossing, sides, np.inf))
    gaps[(gaps < -_ASIDE_M) | (numbers == k)] = np.inf
    if not np.isfinite(gaps).any():
        return None
    nearest = int(np.argmin(gaps))
    widest = _WIDEST_TO_SIDE_M if crossing[nearest] else _WIDEST_M
    return float(gaps[nearest]) if _NARROWEST_M <= gaps[nearest] <= widest else None


def _is_passage(start: FloatArray, along: FloatArray, gap: float, floor: BoolArray, raster: Raster) -> bool:
    """Whether there is floor in the gap, and on both sides of it."""
    normal = np.array([-along[1], along[0]])
    steps = np.linspace(0.15, gap - 0.15, max(3, int(gap / raster.cell_m)))
    line = start + np.outer(steps, along)
    shares = [float(floor[raster.cells(line + offset * normal)].mean()) for offset in (-0.8, -0.4, 0, 0.4, 0.8)]
    return shares[2] > 0.7 and min(shares[1:4]) > 0.4 and min(shares) > 0.15


def _measure(wall: Wall, start: FloatArray, along: FloatArray, gap: float, points: SurfacePoints) -> Opening:
    """The opening from a wall's end on, its jambs where points in the thickness of the wall are."""
    thickness = wall.thickness_m or 0.0
    middle = start + gap / 2 * along
    within = middle if wall.thickness_m else middle - _UNSEEN_M * Segments.of(wall.ends).normals[0]
    steps = [sign * _find_jamb(within, sign * along, gap / 2, thickness, points) for sign in (-1, 1)]
    return Opening(middle + np.outer(steps, along), thickness)


def _find_jamb(
    middle: FloatArray, along: FloatArray, half_m: float, thickness_m: float, points: SurfacePoints
) -> float:
    """How far from the middle the jamb is in a direction: where the first points within the wall's thickness are."""
    apart = points.positions - middle
    steps = apart @ along
    inside = np.abs(apart @ np.array([-along[1], along[0]])) < max(0.03, thickness_m / 2 - 0.02)
    inside &= (steps > 0.5 * _NARROWEST_M) & (steps < half_m + _REACH_M)
    if not inside.any():
        return half_m
    order = np.argsort(steps[inside])
    found, heights = steps[inside][order], np.cumsum(points.weights[inside][order])
    below = np.concatenate([[0.0], heights])
    heaps = below[np.searchsorted(found, found + _JAMB_M)] - below[:-1]
    first = int(np.argmax(heaps > 0.3 * heaps.max()))
    return float(found[np.searchsorted(heights, below[first] + heaps[first] / 2)])


def _is_same(opening: Opening, other: Opening) -> bool:
    return float(np.hypot(*(opening.ends.mean(axis=0) - other.ends.mean(axis=0)))) < 0.5
