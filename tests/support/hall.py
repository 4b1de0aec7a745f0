"""A hall around a block, full of crates of all sizes, driven twice around: what was seen, with or without a filter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from closure_errors import closure_errors
from gridslam.geometry.se2 import between, compose
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, World, simulate
from gridslam.sim.floor_plan import box, join
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_recognition import SubmapRecognition
from gridslam.types import BeamEnds

MAPPER = OccupancyGridMapping()
PLACES = PlaceMatching(max_distance_m=10.0, inlier_ratio=0.75)
RECOGNITION = SubmapRecognition(length_m=20.0, step_m=5.0, apart_m=30.0, certain_sigma_m=0.1)
"""For a lap of 56 m, whatever the tuning."""
DOUBTFUL = DriftModel(sigma_m_per_sqrt_m=0.06, sigma_rad_per_sqrt_m=0.005)
"""Explains a lap's drift of a metre or two, so that no way back is short enough to be known."""


def hall(seed: int) -> World:
    """24 m x 16 m with a block in the middle; crates along the outer wall make every place unlike all others."""
    rng, (width, height) = np.random.default_rng(seed), (24.0, 16.0)
    walls = [box(0, 0, width, height), box(5, 5, width - 5, height - 5)]
    for along, far, end in ((0, 0.0, width), (0, height, width), (1, 0.0, height), (1, width, height)):
        at = 1 + rng.uniform(0, 2)
        while at < end - 2.5:
            side, depth = rng.uniform(0.3, 1.5), rng.uniform(0.2, 0.9)
            low, high = (0.0, depth) if far == 0 else (far - depth, far)
            walls.append(box(at, low, at + side, high) if along == 0 else box(low, at, high, at + side))
            at += side + rng.uniform(0.5, 4)
    lap = [(3.0, 3.0), (width - 3, 3.0), (width - 3, height - 3), (3.0, height - 3)]
    return World.of("hall", join(*walls), [*lap, *lap, lap[0]])


def drive(seed: int, odometry: OdometryNoise | None = None) -> SimulatedLog:
    """Two laps of 56 m, 362 scans."""
    lidar = LidarConfig(rate_hz=3.0, range_max_m=8.0)
    rng = np.random.default_rng(seed)
    return simulate(hall(seed), RobotConfig(v_max_m_s=1.0), odometry or OdometryNoise(), lidar, rng)


@dataclass(frozen=True)
class Seen:
    """True poses (K, 3) of key scans, seen from the first, and their beams."""

    truth: np.ndarray
    beams: Sequence[BeamEnds]


def key_scans(log: SimulatedLog) -> Seen:
    """Scans after each 0.4 m or 0.25 rad."""
    keys, poses = [0], log.truth.poses
    for k, pose in enumerate(poses):
        x, y, turn = between(poses[keys[-1]], pose)
        if math.hypot(x, y) > 0.4 or abs(turn) > 0.25:
            keys.append(k)
    measurements = list(log.measurements)
    return Seen(between(poses[0], poses[keys]), [measurements[k][1].beams(0.05, 30.0) for k in keys])


def tracked(truth: np.ndarray, bias_rad_per_m: float = 0.0, scale: float = 1.0) -> np.ndarray:
    """Poses (K, 3) as a tracker has them that turns and stretches every increment a little."""
    poses = [truth[0]]
    for increment in between(truth[:-1], truth[1:]):
        turn = bias_rad_per_m * math.hypot(increment[0], increment[1])
        poses.append(compose(poses[-1], increment * [scale, scale, 1.0] + [0.0, 0.0, turn]))
    return np.array(poses)


def remember(
    closure_state: LoopClosureState,
    seen: Seen,
    poses: np.ndarray,
    *,
    drift: DriftModel = DOUBTFUL,
    places: PlaceMatching = PLACES,
    recognition: SubmapRecognition = RECOGNITION,
    until: int | None = None,
) -> list[tuple[int, Constraint]]:
    """Go on with a memory as loop closure would, up to key scan `until`; what was recognized, and at which key scan.

    The filter believes what was tracked, and all that is recognized is kept.
    """
    found = []
    search = closure_state.search
    for k in range(len(closure_state.graph), len(poses) if until is None else until):
        x, y, turn = between(poses[k - 1], poses[k]) if k else np.zeros(3)
        closure_state.scans.append(seen.beams[k], poses[k], is_key=True)
        closure_state.graph.extend(poses[k], poses[k], drift.variances(math.hypot(x, y), abs(turn)))
        closure_state.online_poses.append(poses[k])
        places.match_tracked_revisit(closure_state, MAPPER)
        recognition.search(closure_state, MAPPER)
        if search.is_undecided and not search.left:
            search.is_undecided = False
            known = {constraint.measurement.tobytes() for constraint in closure_state.graph.constraints}
            for constraint in recognition.decide(closure_state)[0]:
                if constraint.measurement.tobytes() not in known:
                    closure_state.graph.add(constraint)
                    found.append((k, constraint))
    return found


def errors(truth: np.ndarray, constraints: Sequence[Constraint]) -> np.ndarray:
    """By how many m and rad (K, 2) ties are wrong."""
    ends = [(constraint.from_, constraint.to) for constraint in constraints]
    return np.column_stack(closure_errors(truth, ends, [constraint.measurement for constraint in constraints]))


def trusted(closure_state: LoopClosureState) -> list[Constraint]:
    """Ties that are more than the filter's belief."""
    return [
        constraint
        for constraint in closure_state.graph.constraints
        if constraint.source is not ConstraintSource.PROXIMITY and constraint.determined
    ]
