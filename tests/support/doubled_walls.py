"""Are the walls of the first corridor single or doubled in a folder that `gridslam map` wrote?

For logs without truth on which the robot comes back to where it began, as DP-SLAM's own example does: where the loop is
not closed the corridor is mapped twice, some decimetres or metres apart. No picture has to be looked at.
"""

from __future__ import annotations

import math
from enum import Enum
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.io.maps import read_map
from gridslam.io.trajectories import read_tum
from gridslam.types import FloatArray, OccupancyGrid

_STRAIGHT_M = 0.35  # the robot keeps so near to a line while it follows the first corridor
_SHORTEST_M = 3.0  # of a stretch that tells a corridor's direction
_TILT_RAD = math.radians(10.0)  # by which a robot's way may differ from the walls it follows
_BAND_M = 4.0  # who comes back is so near to the corridor's middle, be it mapped wrongly
_AGAIN_M = 20.0  # of driving until the robot can have come back
_VIEW_M = 8.0  # so far along the corridor walls are seen well
_COLUMN_M, _BIN_M = 0.25, 0.05
_WINDOW = 6  # columns; in so short a piece walls that were mapped a few degrees askew are as good as parallel
_POPULATED = 0.75  # of a window's columns in which a wall must be seen
_APART_M = 0.25  # ends of beams on one wall scatter less
_LOOKED_THROUGH = 0.8  # of what is between two walls of one that is doubled: one of the visits drove there
_FARTHEST_M = 2.5  # behind that a wall is another room's
_LEAST_M = 3.0  # one doubled piece may be a niche, or a door that was opened


@final
class Walls(Enum):
    """What a corridor's walls are."""

    SINGLE = "single"
    DOUBLED = "doubled"
    NOT_SEEN_AGAIN = "not seen again"


class Verdict(NamedTuple):
    """What was found: length of the stretch seen by both visits, how much of it is doubled, and how far apart."""

    walls: Walls
    seen_m: float = 0.0
    doubled_m: float = 0.0
    apart_m: float = 0.0


def judge_folder(folder: Path) -> Verdict:
    """Judge what `gridslam map` wrote: map.yaml with its image, and trajectory.tum."""
    return judge_walls(read_map(folder / "map.yaml"), read_tum(folder / "trajectory.tum").poses)


def judge_walls(grid: OccupancyGrid, poses: FloatArray) -> Verdict:
    """Tell whether the walls of the corridor in which a trajectory (N, 3) begins are doubled in a map.

    Profiles across the corridor, each of 1.5 m of it, must show one wall on each side. Where on one side they show two
    over 3 m or more, both in nearly all of their columns, it is doubled.
    """
    cells, seen = (_places(grid, which) for which in (grid.known & (grid.log_odds > 0), grid.known))
    begin, angle, way = _first_stretch(poses)
    angle = _along_walls(cells, begin, angle, way)
    walls, known, driven = (_turned(points - begin, -angle) for points in (cells, seen, poses[:, :2]))
    stretch = _seen_twice(driven, way)
    if stretch is None:
        return Verdict(Walls.NOT_SEEN_AGAIN)
    low, high = _sides(walls, way)
    middle = (low + high) / 2
    upward, downward = np.array([1, 1]), np.array([1, -1])
    doubled_m, apart_m = max(
        _doubled((walls - [0, middle]) * side, (known - [0, middle]) * side, stretch, (high - low) / 2)
        for side in (upward, downward)
    )
    verdict = Walls.DOUBLED if doubled_m >= _LEAST_M else Walls.SINGLE
    return Verdict(verdict, stretch[1] - stretch[0], doubled_m, apart_m)


def _places(grid: OccupancyGrid, which: NDArray[np.bool_]) -> FloatArray:
    """Centres (K, 2) of cells."""
    rows, columns = np.nonzero(which)
    return (np.column_stack([columns, rows]) + 0.5) * grid.resolution_m + np.asarray(grid.origin)


def _turned(points: FloatArray, angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return points @ np.array([[c, s], [-s, c]])


def _first_stretch(poses: FloatArray) -> tuple[FloatArray, float, tuple[float, float]]:
    """Where the first straight stretch begins (2,), its direction, and from where to where along it the robot goes."""
    points, length = poses[:, :2], np.hypot(*(poses[:, :2] - poses[0, :2]).T)
    found = None
    for end in np.flatnonzero(length >= _SHORTEST_M).tolist():
        part = points[: end + 1]
        away = part - part.mean(axis=0)
        axis = np.linalg.svd(away, full_matrices=False)[2][0]
        if np.abs(away @ [-axis[1], axis[0]]).max() > _STRAIGHT_M:
            break
        axis = axis * np.sign(axis @ (part[-1] - part[0]))
        along = (part - points[0]) @ axis
        found = points[0], math.atan2(axis[1], axis[0]), (float(along.min()), float(along.max()))
    if found is None:
        raise ValueError(f"the robot begins without a straight stretch of {_SHORTEST_M:g} m")
    return found


def _along_walls(cells: FloatArray, begin: FloatArray, angle: float, way: tuple[float, float]) -> float:
    """The direction near `angle` in which the walls beside the first stretch are seen edge on."""

    def sharpness(candidate: float) -> float:
        along, across = _turned(cells - begin, -candidate).T
        near = (along > way[0]) & (along < way[1]) & (np.abs(across) < _BAND_M)
        counts = np.histogram(across[near], np.arange(-_BAND_M, _BAND_M + _BIN_M, _BIN_M))[0]
        return float(np.square(counts).sum())

    return float(max(np.linspace(angle - _TILT_RAD, angle + _TILT_RAD, 81), key=sharpness))


def _seen_twice(driven: FloatArray, way: tuple[float, float]) -> tuple[float, float] | None:
    """From where to where along the corridor both visits see it; None where the robot does not come back."""
    metres = np.append(0.0, np.cumsum(np.hypot(*np.diff(driven, axis=0).T)))
    reach = way[0] - _VIEW_M, way[1] + _VIEW_M
    again = (
        (metres > _AGAIN_M) & (np.abs(driven[:, 1]) < _BAND_M) & (driven[:, 0] > reach[0]) & (driven[:, 0] < reach[1])
    )
    if not again.any():
        return None
    back = driven[again, 0]
    stretch = max(reach[0], float(back.min()) - _VIEW_M), min(reach[1], float(back.max()) + _VIEW_M)
    return stretch if stretch[1] - stretch[0] >= _LEAST_M else None


def _profile(walls: FloatArray, stretch: tuple[float, float], low: float, high: float) -> NDArray[np.bool_]:
    """Whether a wall was seen (columns, bins) at each place along, and each distance from `low` to `high` across."""
    along, across = ((walls - [stretch[0], low]) / [_COLUMN_M, _BIN_M]).T
    shape = int((stretch[1] - stretch[0]) / _COLUMN_M), int((high - low) / _BIN_M)
    inside = (along >= 0) & (along < shape[0]) & (across >= 0) & (across < shape[1])
    seen = np.zeros(shape, bool)
    seen[along[inside].astype(int), across[inside].astype(int)] = True
    return seen


def _peaks(window: NDArray[np.bool_]) -> list[float]:
    """Bins at which walls stand in a window (columns, bins): within two bins of each most columns see one."""
    wide = window.copy()
    for shift in (1, 2):
        wide[:, shift:] |= window[:, :-shift]
        wide[:, :-shift] |= window[:, shift:]
    full = np.flatnonzero(wide.mean(axis=0) >= _POPULATED)
    runs = [run for run in np.split(full, np.flatnonzero(np.diff(full) > 1) + 1) if len(run)]
    return [float(run.mean()) for run in runs]


def _sides(walls: FloatArray, way: tuple[float, float]) -> tuple[float, float]:
    """Where the corridor's two walls are, across it, along the first stretch: those nearest to the robot's way."""
    seen = _profile(walls, way, -_BAND_M, _BAND_M)
    count = np.convolve(seen.mean(axis=0), np.ones(5), "same")
    places = -_BAND_M + (np.arange(len(count)) + 0.5) * _BIN_M
    strong = places[count > 0.4]
    low, high = strong[strong < -0.3], strong[strong > 0.3]
    return (float(low[-1]) if len(low) else -_BAND_M / 2), (float(high[0]) if len(high) else _BAND_M / 2)


def _doubled(walls: FloatArray, known: FloatArray, stretch: tuple[float, float], wall: float) -> tuple[float, float]:
    """How many metres of the wall on the positive side, at about `wall`, are doubled, and how far apart they are."""
    seen, told = (_profile(points, stretch, 0.0, wall + _FARTHEST_M) for points in (walls, known))
    doubled, gaps = np.zeros(len(seen), bool), []
    for first in range(len(seen) - _WINDOW + 1):
        window = slice(first, first + _WINDOW)
        for near, far in pairwise(_peaks(seen[window])):
            between = told[window, int(near) + 1 : int(far)]
            if (far - near) * _BIN_M > _APART_M and between.mean() >= _LOOKED_THROUGH:
                doubled[window] = True
                gaps.append((far - near) * _BIN_M)
    runs = np.split(doubled, np.flatnonzero(np.diff(doubled)) + 1)
    longest = max((len(run) for run in runs if run[0]), default=0)
    return longest * _COLUMN_M, float(np.median(gaps)) if gaps else 0.0
