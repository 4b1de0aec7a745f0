"""Worlds made to deceive: whatever is tied to whatever, nothing is tied to what only looks like it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from closure_errors import FALSE_CLOSURE_RAD, closure_errors, false_closures
from closure_worlds import DECEPTIVE, deceptive
from gridslam.config import Configuration, build
from gridslam.evaluation import absolute_errors
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import FullSlam, full_slam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.types import Trajectory

CONFIG = Configuration()
PARTICLES = 10


@dataclass(frozen=True)
class Driven:
    """A drive of 100 to 200 m, its true poses, and what was made of it."""

    truth: Trajectory
    odometry: Trajectory
    state: GridFastSlamState
    answer: FullSlam

    @property
    def key_truth(self) -> np.ndarray:
        """True poses (T, 3) of the key scans."""
        return self.truth.poses[self.state.closure_state.scans.keys]


@pytest.fixture(scope="module", params=DECEPTIVE)
def driven(request) -> tuple[str, Driven]:
    log, recorder = deceptive(request.param, 0).simulate(), TrajectoryRecorder()
    rng = np.random.default_rng(0)
    state = run(log.measurements, build(replace(CONFIG, particles=PARTICLES)), rng=rng, observers=[recorder])
    parts = CONFIG.mapper, CONFIG.loop_closure
    answer = full_slam(state, [recorder.tracked_scans()], *parts)
    return request.param, Driven(log.truth, log.odometry, state, answer)


def test_nothing_false_is_recognized_or_known(driven):
    """Not while the robot drives. The filter's mere belief, which is told as such, is judged by the next test."""
    _, drive = driven
    constraints = [
        constraint
        for constraint in drive.state.closure_state.graph.constraints
        if constraint.source is not ConstraintSource.PROXIMITY and constraint.determined
    ]
    edges, measured = (
        [(constraint.from_, constraint.to) for constraint in constraints],
        [constraint.measurement for constraint in constraints],
    )
    assert not false_closures(drive.key_truth, edges, measured).any()


def test_nothing_in_the_final_graph_is_false(driven):
    """Of all its ties; of those in a bare corridor, which may say nothing along it, the heading."""
    kind, drive = driven
    graph = drive.answer.graph
    constraints = slice(len(graph.poses) - 1, None)
    edges, measured = graph.edges[constraints], graph.measurements[constraints]
    if kind == "bare_corridors":
        assert (closure_errors(drive.key_truth, edges, measured)[1] < FALSE_CLOSURE_RAD).all()
    else:
        assert not false_closures(drive.key_truth, edges, measured).any()
        assert len(edges) > 10  # or nothing would be shown


def test_no_world_is_torn(driven):
    """A false closure would cost metres. Measured, aligned: at most 0.4 % of the way, and a third of the odometry's."""
    _, drive = driven
    found, odometry = (
        absolute_errors(Trajectory(drive.truth.stamps_ns, poses), drive.truth)
        for poses in (drive.answer.poses, drive.odometry.poses)
    )
    way = np.hypot(*np.diff(drive.truth.poses[:, :2], axis=0).T).sum()
    assert found.trans_max_m < 0.01 * way
    assert found.trans_rmse_m < 0.5 * odometry.trans_rmse_m
    assert found.rot_rmse_deg < 2.0
