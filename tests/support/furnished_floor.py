"""A furnished floor of up to eight rooms about a corridor, 26 m x 13.5 m, on which a robot drives from anywhere."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import final

import numpy as np

from gridslam.config import Configuration, build
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, World, simulate
from gridslam.sim.floor_plan import clearance, furniture, join
from gridslam.slam.full_slam.earlier_pieces import EarlierPieces
from gridslam.slam.full_slam.full_slam import full_slam
from gridslam.types import FloatArray
from passages import carve, tour

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
LIDAR = LidarConfig(beams=180, rate_hz=4.0)


@final
class Floor:
    """A floor with furniture that was drawn at random."""

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


def is_found(day: SimulatedLog, later: SimulatedLog, seed: int) -> bool:
    """Return whether a robot is found in the map of an earlier day, from an origin of its own."""
    configuration = Configuration()
    slam = build(configuration)
    assert configuration.loop_closure is not None
    recorder, rng = TrajectoryRecorder(), np.random.default_rng(seed)
    state = run(day.measurements, slam, rng=rng, observers=[recorder])
    piece = full_slam(state, [recorder.tracked_scans()], configuration.mapper, configuration.loop_closure).piece
    assert piece is not None
    state = run(later.measurements[:1], slam, rng=rng)
    assert state.closure_state is not None
    state.closure_state.earlier = EarlierPieces([piece], configuration.mapper, configuration.loop_closure.places)
    state = run(later.measurements[1:], slam, rng=rng, state=state)
    return state.closure_state is not None and state.closure_state.joined >= 0
