"""One floor driven day after day, its furniture moved every night: is the map that of the newest day?

A floor of up to eight rooms about a corridor, 26 m x 13.5 m. Every day the robot begins at another place; each piece of
furniture was put elsewhere overnight with probability 0.1. Each day is found in the piece that the days before have
left, joined with it, and refined with it; then the piece is thinned. A row for each day:

- found_m: metres driven until the robot was found;
- bytes: of the piece and its drives as arrays, compressed, after the day; thinned_bytes when it was thinned;
- missed_m: mean error of the day's poses seen from the nearest pose of an earlier day, m;
- walls, stands: share of the cells of walls that were seen, and of furniture that was seen today, that are occupied in
  the day's map, or a cell beside them is;
- gone: share of the cells where furniture stood and was seen, and that beams of ten scans have passed since, that are
  free.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple, final

import numpy as np

from gridslam.config import Configuration, build
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, transform_points
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.serialization import to_arrays
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, World, simulate
from gridslam.sim.floor_plan import carve, clearance, furniture, join
from gridslam.sim.lidar import cast_rays
from gridslam.sim.world import tour
from gridslam.slam.full_slam.earlier_pieces import EarlierPieces
from gridslam.slam.full_slam.full_slam import FullSlam, full_slam
from gridslam.slam.full_slam.full_trajectory import TrackedScans
from gridslam.slam.full_slam.thinning import thin_piece
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.types import FloatArray, IntArray, OccupancyGrid, StepReport

ROOMS = (
    *((0.0, 0.0, 6.0, 5.85), (6.15, 0.0, 11.0, 5.85), (11.15, 0.0, 18.0, 5.85), (18.15, 0.0, 26.0, 5.85)),
    *((0.0, 8.35, 8.0, 13.5), (8.15, 8.35, 14.0, 13.5), (14.15, 8.35, 20.0, 13.5), (20.15, 8.35, 26.0, 13.5)),
)
_DOORS_M = (3.0, 8.5, 15.0, 22.0, 4.0, 11.5, 17.2, 23.0)
_BETWEEN = {(2, 3): (18.0, 2.0, 18.15, 3.4), (4, 5): (8.0, 10.1, 8.15, 11.5)}
_LANE_M = 0.5
_APART_M = 1.5
_PIECES = 4
"""Of furniture in each room."""
_MOVES = 0.1
LIDAR = LidarConfig(beams=180, rate_hz=4.0)
_HITS = 3
_SCANS = 10
"""Beams that end in a cell, and scans of which a beam passes it, before it counts as seen."""
_FREE = math.log(0.196 / 0.804)
_OCCUPIED = math.log(0.65 / 0.35)
"""Log-odds at which map_server takes a cell for free or occupied."""


@final
class Floor:
    """A floor whose furniture is moved overnight."""

    def __init__(self, seed: int, rooms: Sequence[int] = range(len(ROOMS))) -> None:
        """Furnish some of the rooms; the others are not there."""
        self.rng = np.random.default_rng(seed)
        order = sorted(rooms, key=_DOORS_M.__getitem__)
        doors = [(_DOORS_M[k] - 0.55, 5.8, _DOORS_M[k] + 0.55, 6.05) for k in order if k < 4]
        doors += [(_DOORS_M[k] - 0.55, 8.15, _DOORS_M[k] + 0.55, 8.4) for k in order if k >= 4]
        joined = {pair: gap for pair, gap in _BETWEEN.items() if set(pair) <= set(rooms)}
        corridor = (0.0, 6.0, max(ROOMS[k][2] for k in order), 8.2)
        self.walls = carve([*(ROOMS[k] for k in order), corridor, *doors, *joined.values()])
        inside = {k: len(order) + at for at, k in enumerate(order)}
        junctions = [(_DOORS_M[k], 7.1) for k in order] + [(_DOORS_M[k], 2.7 if k < 4 else 10.8) for k in order]
        self._junctions = np.array(junctions)
        self._passages = [*pairwise(range(len(order))), *((at, inside[k]) for at, k in enumerate(order))]
        self._passages += [(inside[a], inside[b]) for a, b in joined]
        lanes = [self._junctions[list(ends)] for ends in self._passages]
        self._lane = np.concatenate([np.linspace(a, b, 2 + int(4 * math.dist(a, b))) for a, b in lanes])
        self.pieces: list[tuple[int, FloatArray]] = []
        for room in order:
            for _ in range(_PIECES):
                self.pieces.append((room, self._place(room, [piece for at, piece in self.pieces if at == room])))

    def _place(self, room: int, others: Sequence[FloatArray]) -> FloatArray:
        """A piece of furniture (5,) somewhere in a room, off the robot's ways and off the others."""
        x0, y0, x1, y1 = ROOMS[room]
        while True:
            size = self.rng.uniform((0.5, 0.4), (1.6, 0.8))
            heading = self.rng.choice([0.0, math.pi / 2, self.rng.uniform(0, math.pi)])
            half = 0.5 * float(np.hypot(*size)) + 0.05
            x, y = self.rng.uniform((x0 + half, y0 + half), (x1 - half, y1 - half)).tolist()
            piece = np.array([x, y, *size, heading])
            is_clear = clearance(furniture(*piece), self._lane).min() > _LANE_M
            if is_clear and all(math.dist(piece[:2], other[:2]) > _APART_M for other in others):
                return piece

    def pass_night(self) -> None:
        """Put some pieces elsewhere in their rooms."""
        for k, (room, _) in enumerate(self.pieces):
            if self.rng.random() < _MOVES:
                others = [piece for j, (other, piece) in enumerate(self.pieces) if other == room and j != k]
                self.pieces[k] = room, self._place(room, others)

    @property
    def furniture(self) -> FloatArray:
        """Walls (S, 4) of all pieces."""
        return join(*(furniture(*piece) for _, piece in self.pieces))

    def drive(self, length_m: float) -> SimulatedLog:
        """Drive about for a day, from anywhere."""
        first = int(self.rng.integers(len(self._passages)))
        passages = [self._passages[first], *self._passages[:first], *self._passages[first + 1 :]]
        route = tour(self._junctions, passages, length_m, self.rng)
        world = World.of("day", join(self.walls, self.furniture), route)
        return simulate(world, RobotConfig(v_max_m_s=0.8), OdometryNoise(), LIDAR, self.rng)


@final
class Day(NamedTuple):
    """What a day has brought."""

    answer: FullSlam
    found_m: float


@final
@dataclass
class Session:
    """A piece that is gone on with day by day, its drives, and the true poses (N, 3) of their scans."""

    configuration: Configuration
    piece: MapPiece | None = None
    drives: list[TrackedScans] = field(default_factory=list)
    truth: FloatArray = field(default_factory=lambda: np.empty((0, 3)))

    def map_day(self, log: SimulatedLog, seed: int) -> Day:
        """Map a day in what was left of those before, from an origin of its own."""
        configuration = self.configuration
        slam = build(configuration)
        recorder = TrajectoryRecorder()
        rng = np.random.default_rng(seed)
        state = run(log.measurements[:1], slam, rng=rng, observers=[recorder])
        if self.piece is not None:
            closures_of(state).earlier = locator(self.piece, configuration)
        joined_at: list[int] = []

        def watch(report: StepReport, state: GridFastSlamState, seconds: float) -> None:
            if not joined_at and (self.piece is None or closures_of(state).joined >= 0):
                joined_at.append(len(recorder.keys))

        state = run(log.measurements[1:], slam, rng=rng, observers=[recorder, watch], state=state)
        if not joined_at:
            raise AssertionError("the robot was not found")
        self.drives = [*self.drives, recorder.tracked_scans(0 if self.piece is None else len(self.piece))]
        answer = full_slam(state, self.drives, configuration.mapper, configuration.loop_closure)
        truth = np.array(log.truth.poses)
        self.truth = np.concatenate([self.truth, truth])
        self.piece = answer.piece
        driven_m = np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))
        return Day(answer, float(driven_m[joined_at[0] - 2]))

    def thin(self) -> None:
        """Leave out what adds nothing."""
        assert self.piece is not None
        thinned = thin_piece(self.piece, self.drives, self.configuration.mapper)
        self.piece = thinned.piece
        self.drives = [drive for drive in thinned.drives if len(drive.keys)]
        self.truth = self.truth[thinned.scans]

    @property
    def nbytes(self) -> int:
        """Bytes of the piece and its drives in a compressed file."""
        return 0 if self.piece is None else count_bytes(self.piece, self.drives)

    def missed_m(self, answer: FullSlam) -> float | None:
        """Mean error of the newest drive's poses, each as seen from the nearest one of an earlier drive."""
        new = len(self.drives[-1].keys)
        old = len(self.truth) - new
        if not old:
            return None
        from scipy.spatial import KDTree

        nearest = KDTree(self.truth[:old, :2]).query(self.truth[old:, :2])[1]
        found = between(answer.poses[nearest], answer.poses[old:])
        return float(np.hypot(*(found - between(self.truth[nearest], self.truth[old:]))[:, :2].T).mean())


def closures_of(state: GridFastSlamState) -> LoopClosureState:
    """Give the loop-closure state, which there is in this benchmark."""
    assert state.closure_state is not None
    return state.closure_state


def locator(piece: MapPiece, configuration: Configuration) -> EarlierPieces:
    """Give what finds a robot in a piece."""
    assert configuration.loop_closure is not None
    return EarlierPieces([piece], configuration.mapper, configuration.loop_closure.places)


def count_bytes(piece: MapPiece, drives: Sequence[TrackedScans]) -> int:
    """Bytes of a piece and its drives in a compressed file."""
    arrays = to_arrays(piece)
    for k, drive in enumerate(drives):
        arrays |= {f"drive{k}.keys": drive.keys, f"drive{k}.key_from_base": drive.key_from_base}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getbuffer().nbytes


@final
class Sights:
    """Cells of furniture that were seen, by the truth: those that stand, and those that are gone and looked into."""

    def __init__(self, walls: FloatArray, resolution_m: float) -> None:
        self._walls = walls
        self._resolution_m = resolution_m
        self._gone: dict[tuple[int, int], int] = {}
        self.standing: set[tuple[int, int]] = set()
        self.fixed: set[tuple[int, int]] = set()

    def see(self, log: SimulatedLog, pieces: FloatArray) -> None:
        """Look at the floor as the log's robot does, furniture (S, 4) in it."""
        truth = np.array(log.truth.poses)
        bearings = log.measurements[0].scan.geometry.bearings
        whole = join(self._walls, pieces)
        ranges = cast_rays(whole, truth, bearings)
        is_piece = cast_rays(self._walls, truth, bearings) > ranges + 1e-6
        is_piece &= ranges < LIDAR.range_max_m
        ends = transform_points(
            truth[:, None], np.stack([np.cos(bearings), np.sin(bearings)], -1)[None] * ranges[..., None]
        )
        cells, counts = np.unique(self._cells(ends[is_piece]), axis=0, return_counts=True)
        before = self.standing
        self.standing = set(map(tuple, cells[counts >= _HITS].tolist()))
        cells, counts = np.unique(
            self._cells(ends[~is_piece & (ranges < LIDAR.range_max_m)]), axis=0, return_counts=True
        )
        self.fixed |= set(map(tuple, cells[counts >= _HITS].tolist()))
        candidates = [*before.difference(self._gone), *self._gone]
        points = self._resolution_m * (np.array(candidates).reshape(-1, 2) + 0.5)
        passed = self._count_beams(truth, bearings, ranges, points)
        away = clearance(whole, points)
        for cell, distance, beams in zip(candidates, away.tolist(), passed.tolist(), strict=True):
            if distance > 3 * self._resolution_m:
                self._gone[cell] = self._gone.get(cell, 0) + beams
            else:
                self._gone.pop(cell, None)

    @property
    def gone(self) -> list[tuple[int, int]]:
        """Cells where furniture stood that were looked into since it has gone."""
        return [cell for cell, beams in self._gone.items() if beams >= _SCANS]

    def points(self, cells: Sequence[tuple[int, int]] | set[tuple[int, int]]) -> FloatArray:
        """Middles (K, 2) of cells."""
        return self._resolution_m * (np.array(sorted(cells)).reshape(-1, 2) + 0.5)

    def _cells(self, points: FloatArray) -> IntArray:
        return np.floor(points / self._resolution_m).astype(np.int64)

    def _count_beams(self, truth: FloatArray, bearings: FloatArray, ranges: FloatArray, points: FloatArray) -> IntArray:
        """Scans (K,) of which a beam passes a cell, by the middles (K, 2) of the cells, and ends well behind it."""
        counts = np.zeros(len(points), np.int64)
        for pose, reach in zip(truth, ranges, strict=True):
            x, y = (points - pose[:2]).T
            away, bearing = np.hypot(x, y), wrap(np.arctan2(y, x) - pose[2])
            beam = np.clip(np.rint((bearing - bearings[0]) / (bearings[1] - bearings[0])), 0, len(bearings) - 1)
            beam = beam.astype(np.int64)
            is_hit = np.abs(bearing - bearings[beam]) * away < 0.5 * self._resolution_m
            counts += is_hit & (reach[beam] > away + 2 * self._resolution_m)
        return counts


def live(
    days: int, seed: int, floor: Floor, length_m: float = 90.0, configuration: Configuration | None = None
) -> Iterator[tuple[dict[str, Any], OccupancyGrid]]:
    """Drive day after day; a row and the map of each."""
    session = Session(configuration or Configuration())
    sights = Sights(floor.walls, session.configuration.mapper.resolution_m)
    for number in range(1, days + 1):
        if number > 1:
            floor.pass_night()
        log = floor.drive(length_m)
        sights.see(log, floor.furniture)
        day = session.map_day(log, seed + number)
        row: dict[str, Any] = {"day": number, "scans": len(log), "found_m": day.found_m, "bytes": session.nbytes}
        frame = align(day.answer.poses, session.truth)
        row["missed_m"] = session.missed_m(day.answer)
        session.thin()
        grid = day.answer.map
        row |= {
            "thinned_bytes": session.nbytes,
            **look_at(grid, sights, frame),
        }
        yield row, grid


def look_at(grid: OccupancyGrid, sights: Sights, frame: FloatArray) -> dict[str, Any]:
    """Shares of the cells that were seen that are in a map as they should be; `frame` (3,) is that of the floor."""
    fixed, standing, gone = (
        transform_points(frame, sights.points(cells)) for cells in (sights.fixed, sights.standing, sights.gone)
    )
    return {
        "walls": float(np.mean(greatest(grid, fixed) > _OCCUPIED)),
        "stands": float(np.mean(greatest(grid, standing) > _OCCUPIED)),
        "gone": float(np.mean(next(look_up(grid, gone, 0)) < _FREE)) if len(gone) else None,
        "cells": {"walls": len(fixed), "stands": len(standing), "gone": len(gone)},
    }


def look_up(grid: OccupancyGrid, points: FloatArray, reach: int) -> Iterator[FloatArray]:
    """Log-odds (K,) of the cells of points (K, 2) and of those about them, 0 where unknown."""
    column, row = np.floor((points - grid.origin) / grid.resolution_m).astype(np.int64).T
    height, width = grid.shape
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            y = np.clip(row + dy, 0, height - 1)
            x = np.clip(column + dx, 0, width - 1)
            yield np.where(grid.known[y, x], grid.log_odds[y, x], 0.0)


def greatest(grid: OccupancyGrid, points: FloatArray) -> FloatArray:
    """Greatest log-odds (K,) within a cell of points (K, 2): a scan is matched, and its beams end, to a cell or so."""
    return np.max(list(look_up(grid, points, 1)), axis=0)


def align(found: FloatArray, truth: FloatArray) -> FloatArray:
    """Pose (3,) of the frame of true poses (N, 3) in that of the map, by least squares over the positions."""
    a = found[:, 0] + 1j * found[:, 1]
    b = truth[:, 0] + 1j * truth[:, 1]
    turn = float(np.angle(np.sum((a - a.mean()) * np.conj(b - b.mean()))))
    begin = a.mean() - np.exp(1j * turn) * b.mean()
    return np.array([begin.real, begin.imag, turn])
