"""Drives on which old places have to be recognized: the laser is blind for some metres, or the way is long.

Scan matching repairs what odometry gets wrong while the laser sees. A blackout is what it cannot repair: a dirty
window, a dropped driver. Scans are left out for some metres, and odometry turns and stretches the way meanwhile. On the
grounds there is none: over 1 km to 3 km, with a scan every metre and angles that are misread, tracked motion drifts as
on real logs.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from typing import NamedTuple, final

import numpy as np
from scipy.ndimage import minimum_filter

from closure_worlds import DECEPTIVE, course
from gridslam.geometry.se2 import between, compose, exp, log, transform_points
from gridslam.grid.tiles import TileMaps
from gridslam.io.measurement import Measurement
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching import BranchAndBound, Pyramid
from gridslam.matching.gauss_newton import EVALUATE_ONLY, degenerate_direction
from gridslam.types import Beams, FloatArray, IntArray, LaserScan, Odometry, ScanGeometry
from simulated import thin

HONEST = ("rooms", "demo", "loop", "random")
KINDS = (*HONEST, *DECEPTIVE)
_UNLIKE = (*HONEST, "moved_furniture")
APART_M = 30.0
"""A place seen so many metres of driving before is an old one."""

_BETWEEN_M = 8.0
_BACK_M = 1.0  # the robot is back where it is as near as this to its way before
_NEAREST_M, _FARTHEST_M = 0.05, 30.0

_KEY_M, _KEY_RAD = 0.5, 0.5
_ENDS_M, _CELL_M, _SEEN = 0.15, 0.05, 0.6
_DETERMINED = 0.02  # least eigenvalue of the position's information, per agreeing beam: `gauss_newton`'s own
_RIVAL = 0.9
_THERE_M, _THERE_RAD = 0.3, 0.1
_FEWEST = 30  # beams
_QUERY = 8  # key scans by which a place is told from others
_JOINED_M, _SHORTEST_M = 2.0, 2.0
_PIECE_M = 10.0
_MISREAD = 179 / 180
"""Angles of a laser whose 180 beams are taken for 180 steps, and not 179: turns appear smaller by as much."""
_ROW = np.zeros(1, np.int32)
_LOOSE = np.full((1, 3, 3), 1e-9) * np.eye(3)


class _Dark(NamedTuple):
    """Between what limits blackouts are drawn: each one's length, and the errors of all of them together."""

    count: tuple[int, int]
    length_m: tuple[float, float]
    heading_deg: tuple[float, float]
    scale: tuple[float, float]


_DECEPTIVE = _Dark((2, 3), (4.0, 8.0), (12.0, 24.0), (0.04, 0.10))
_HONEST = _Dark((3, 3), (6.0, 10.0), (20.0, 40.0), (0.06, 0.12))
"""Where each room is unlike the others, the next scan that sees something known would put lesser errors right."""


@final
@dataclass(frozen=True, eq=False)
class Drive:
    """A drive of which the truth is known.

    Attributes
    ----------
    name : str
    everything : list of Measurement, length N
        With the odometry that is wrong; in blackouts, too.
    truth : (N, 3) float64
        True poses.
    dark : (B, 2) float64, m
        Metres driven at which each blackout begins and ends.
    """

    name: str
    everything: list[Measurement]
    truth: FloatArray
    dark: FloatArray

    @property
    def lit(self) -> IntArray:
        """Which measurements the log has: those outside of blackouts."""
        return np.flatnonzero(~_within(self.dark, driven_m(self.truth)))


def driven_m(poses: FloatArray) -> FloatArray:
    """Metres driven (N,) up to each pose."""
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T)))


def _within(spans: FloatArray, at: FloatArray) -> np.ndarray:
    return ((at > spans[:, :1]) & (at < spans[:, 1:])).any(axis=0)


def simulated(kind: str, seed: int) -> Drive:
    """Simulate a drive with one to three blackouts: an honest world or one made to deceive, or the campus.

    And one on the grounds, without any.
    """
    rng = np.random.default_rng([seed, zlib.crc32(kind.encode())])
    log = course(kind, seed).simulate()
    scans, truth = [scan for _, scan in log.measurements], np.asarray(log.truth.poses)
    strength = _HONEST if kind in _UNLIKE else _DECEPTIVE
    dark, wrong = np.empty((0, 2)), np.asarray(log.odometry.poses)
    if kind == "grounds":
        seen = scans[0].geometry
        read = ScanGeometry(_MISREAD * seen.bearings, seen.base_from_laser)
        scans = [replace(scan, geometry=read) for scan in scans]
    else:
        dark = _blackouts(truth, scans, strength, rng)
        wrong = _misled(wrong, driven_m(truth), dark, strength, rng)
    odometry = [Odometry.at(scan.stamp_ns, pose) for scan, pose in zip(scans, wrong, strict=True)]
    return Drive(f"{kind} {seed}", list(map(Measurement, odometry, scans)), truth, dark)


def _blackouts(truth: FloatArray, scans: list[LaserScan], strength: _Dark, rng: np.random.Generator) -> FloatArray:
    """Draw one to three stretches (B, 2), apart from each other, in metres driven.

    Those are drawn after which the robot returns to what it saw before them, where there are such; and of these the
    tenth at whose ends the laser sees the least of what it saw before: that would put the robot right at once.
    """
    driven, keys = driven_m(truth), np.array(thin(truth, _KEY_M, _KEY_RAD))
    beams = {k: scans[k].beams(_NEAREST_M, _FARTHEST_M) for k in keys.tolist()}
    seen = _FirstSeen(truth, driven, keys, beams)
    away = np.hypot(*(truth[keys, None, :2] - truth[None, keys, :2]).transpose(2, 0, 1))
    old = driven[keys, None] - driven[None, keys] >= APART_M
    first = np.where(old & (away < _BACK_M), driven[None, keys], np.inf).min(axis=1)  # when the robot was here first
    spans: list[tuple[float, float]] = []
    for length in rng.uniform(*strength.length_m, rng.integers(*strength.count, endpoint=True)).tolist():
        rated = []
        for begin in np.arange(_BETWEEN_M, driven[-1] - length - _BETWEEN_M, 0.5).tolist():
            end = begin + length
            if all(end + _BETWEEN_M < b or begin > e + _BETWEEN_M for b, e in spans):
                after = keys[driven[keys] > end][:3].tolist()
                returns = (first[driven[keys] > end + 2.0] < begin).any()
                rated.append((not returns, np.mean([seen.share(truth[k], beams[k], begin) for k in after]), begin))
        best = [begin for none, _, begin in sorted(rated)[: max(len(rated) // 10, 1)] if none == min(rated)[0]]
        if best:
            begin = float(rng.choice(best))
            spans.append((begin, begin + length))
    return np.array(sorted(spans)).reshape(-1, 2)


def _misled(
    odometry: FloatArray, driven: FloatArray, dark: FloatArray, strength: _Dark, rng: np.random.Generator
) -> FloatArray:
    """Odometry (N, 3) that in blackouts turns beside the true turns, all to one side, and is long or short."""
    side, longer = rng.choice([-1.0, 1.0], 2).tolist()
    rate = side * math.radians(rng.uniform(*strength.heading_deg)) / float(np.diff(dark).sum())
    scale = 1 + longer * rng.uniform(*strength.scale)
    twists = log(between(odometry[:-1], odometry[1:]))
    blind = _within(dark, driven[1:])
    twists[blind, 2] += rate * np.diff(driven)[blind]
    twists[blind, :2] *= scale
    poses = [odometry[0]]
    for step in exp(twists):
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def certain_revisits(drive: Drive) -> FloatArray:
    """Arcs (R, 2) of the drive, in metres driven, along which it is certain by the truth that the place is an old one.

    At each of its key scans most beams end on structure that was seen long before, and before the last blackout; they
    determine the pose; and nowhere else in the whole world do they fit nearly as well. No run of a mapper is needed.
    """
    driven, keys = driven_m(drive.truth), np.array(thin(drive.truth, _KEY_M, _KEY_RAD))
    beams = {k: drive.everything[k].scan.beams(_NEAREST_M, _FARTHEST_M) for k in keys.tolist()}
    shown = keys[np.isin(keys, drive.lit)]
    old, world, drawn = OccupancyGridMapping().empty(1), OccupancyGridMapping().empty(1), 0
    for k in keys.tolist():
        world.update(_ROW, drive.truth[k : k + 1], beams[k])
    pyramid, first = Pyramid.of(world, 0), _FirstSeen(drive.truth, driven, shown, beams)
    certain = []
    for k in shown.tolist():
        begun = drive.dark[drive.dark[:, 1] <= driven[k], 0]
        by = float(min([driven[k] - APART_M, *begun[-1:]]))
        while drawn < len(shown) and driven[shown[drawn]] <= by:
            j = int(shown[drawn])
            old.update(_ROW, drive.truth[j : j + 1], beams[j])
            drawn += 1
        seen = len(beams[k]) >= _FEWEST and first.share(drive.truth[k], beams[k], by) >= _SEEN
        if not seen or not _determined(old, drive.truth[k], beams[k]):
            continue
        if _alone(pyramid, drive.truth, k, _lately(drive, shown, k, beams)):
            certain.append(float(driven[k]))
    return _arcs(certain)


def revisited_way(drive: Drive) -> FloatArray:
    """Pieces (R, 2) of 10 m at most, in metres driven, on which the robot is where it was long before."""
    driven, keys = driven_m(drive.truth), np.array(thin(drive.truth, _KEY_M, _KEY_RAD))
    places, at = drive.truth[keys, :2], driven[keys]
    before = np.searchsorted(at, at - APART_M)
    near = [np.hypot(*(places[:k] - place).T).min(initial=np.inf) for k, place in zip(before, places, strict=True)]
    arcs = _arcs(at[np.array(near) < _BACK_M].tolist())
    return np.array(
        [(m, min(m + _PIECE_M, end)) for begin, end in arcs.tolist() for m in np.arange(begin, end, _PIECE_M)]
    )


@final
class _FirstSeen:
    """For each cell of the plane, after how many metres of driving something was first seen near it."""

    def __init__(self, truth: FloatArray, driven: FloatArray, shown: IntArray, beams: dict[int, Beams]) -> None:
        cells = [_cells(truth[k], beams[k]) for k in shown.tolist()]
        every, metres = np.concatenate(cells), np.repeat(driven[shown], [len(some) for some in cells])
        reach = round(_ENDS_M / _CELL_M)
        self._corner = every.min(axis=0) - reach
        grid = np.full(np.ptp(every, axis=0) + 2 * reach + 1, np.inf)
        np.minimum.at(grid, tuple((every - self._corner).T), metres)
        disc = np.hypot(*np.mgrid[-reach : reach + 1, -reach : reach + 1]) <= reach
        self._grid = minimum_filter(grid, footprint=disc, mode="constant", cval=np.inf)

    def share(self, pose: FloatArray, beams: Beams, by_m: float) -> float:
        """Share of the beams that end on what was seen after so many metres, or before."""
        return float((self._grid[tuple((_cells(pose, beams) - self._corner).T)] <= by_m).mean())


def _cells(pose: FloatArray, beams: Beams) -> IntArray:
    return np.floor(transform_points(pose, beams.ends) / _CELL_M).astype(np.int64)


def _determined(old: TileMaps, pose: FloatArray, beams: Beams) -> bool:
    match = EVALUATE_ONLY(old, _ROW, pose[None], _LOOSE, beams)
    return degenerate_direction(match.information[0], float(match.score[0]), _DETERMINED) is None


def _lately(drive: Drive, shown: IntArray, scan: int, beams: dict[int, Beams]) -> FloatArray:
    """Ends (B, 2) of the beams of the last key scans, seen from the newest: of those after the last blackout."""
    driven = driven_m(drive.truth)
    begun = max([-np.inf, *drive.dark[drive.dark[:, 1] <= driven[scan], 1].tolist()])
    last = [k for k in shown[shown <= scan][-_QUERY:].tolist() if driven[k] >= begun]
    seen = between(drive.truth[scan], drive.truth[last])
    return np.concatenate([transform_points(pose, beams[k].ends) for k, pose in zip(last, seen, strict=True)])


def _alone(pyramid: Pyramid, truth: FloatArray, scan: int, points: FloatArray) -> bool:
    """Whether points (B, 2) fit the whole world, at any heading, where a scan saw them, and nowhere else nearly."""
    low, high = truth[:, :2].min(axis=0), truth[:, :2].max(axis=0)
    middle = np.append((low + high) / 2, truth[scan, 2])
    reach = min(float((high - low).max()) / 2 + 5.0, 100.0)
    search = BranchAndBound(window_m=reach, window_rad=math.pi, min_runner_up_ratio=_RIVAL)
    found = search.search(pyramid, middle, None, points)
    if found is None or found.runner_up_score >= _RIVAL * found.score:
        return False
    x, y, turn = between(truth[scan], found.pose)
    return math.hypot(x, y) < _THERE_M and abs(turn) < _THERE_RAD


def _arcs(certain: list[float]) -> FloatArray:
    """Spans (R, 2) of ascending places with small gaps between them, those left out that are too short."""
    cuts = np.flatnonzero(np.diff(certain) > _JOINED_M) + 1
    groups = [group for group in np.split(np.array(certain), cuts) if len(group)]
    return np.array([(g[0], g[-1]) for g in groups if g[-1] - g[0] >= _SHORTEST_M]).reshape(-1, 2)
