"""The final refinement: no worse than the filter's trajectory, and just what was tracked where nothing ties it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from gridslam.evaluation import absolute_errors
from gridslam.geometry.se2 import between
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import OdometryNoise, SimulatedLog
from gridslam.slam import GridFastSlam
from gridslam.slam.full_slam.full_trajectory import full_trajectory
from gridslam.slam.full_slam.global_scan_refinement import RefinementResult, refine_trajectory
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.types import Trajectory
from support import hall
from support.loops import loop_drive

CLOSURE = LoopClosure()
SLAM = GridFastSlam(loop_closure=CLOSURE)


@dataclass(frozen=True)
class Refined:
    """A run, and its final refinement."""

    log: SimulatedLog
    state: GridFastSlamState
    recorder: TrajectoryRecorder
    closure_state: LoopClosureState
    refinement: RefinementResult


def refine(log: SimulatedLog) -> Refined:
    recorder = TrajectoryRecorder()
    state = run(log.measurements, replace(SLAM, particles=3), rng=np.random.default_rng(1), observers=[recorder])
    closure_state = state.closure_state.snapshot()
    trajectory = state.ancestry.trajectory(state.best)
    said = refine_trajectory(closure_state, trajectory, [recorder.tracked_scans()], SLAM.mapper, CLOSURE)
    return Refined(log, state, recorder, closure_state, said)


@pytest.fixture(scope="module")
def halls() -> list[Refined]:
    poor = OdometryNoise(distance_scale=1.03, turn_scale=0.95, bias_rad_per_m=0.01)
    return [refine(hall.drive(seed, poor)) for seed in (0, 2)]


@pytest.fixture(scope="module")
def loop() -> Refined:
    return refine(loop_drive())


def errors(run: Refined, poses: np.ndarray):
    truth = Trajectory(run.log.truth.stamps_ns, between(run.log.truth.poses[0], run.log.truth.poses))
    return absolute_errors(Trajectory(truth.stamps_ns, poses), truth)


def test_final_refinement_is_no_worse_than_the_filter(halls, loop):
    """By a centimetre, a fifth of a cell, at most; where the filter is off by most of a cell, it is better.

    Over all scans, aligned.
    """
    for one in (*halls, loop):
        filtered, said = errors(one, one.recorder.best_trajectory(one.state).poses), errors(one, one.refinement.poses)
        assert said.trans_rmse_m < filtered.trans_rmse_m + 0.01
        assert said.rot_rmse_deg < filtered.rot_rmse_deg + 0.1
        assert said.trans_rmse_m < 0.07
        assert one is loop or said.trans_rmse_m < max(filtered.trans_rmse_m, 0.04)
        assert one.refinement.pairs > 50  # it was tied


def test_constraints_of_final_refinement_are_right(halls, loop):
    for one in (*halls, loop):
        truth = one.log.truth.poses[one.state.closure_state.scans.keys]
        graph = one.refinement.graph
        pairs = slice(len(graph.edges) - one.refinement.pairs, None)
        errors = between(graph.measurements[pairs], between(*(truth[ends] for ends in graph.edges[pairs].T)))
        off = np.hypot(errors[:, 0], errors[:, 1])
        off = off[np.linalg.eigvalsh(graph.information[pairs][:, :2, :2])[:, 0] > 250]
        assert len(off) > 50
        assert np.quantile(off, 0.95) < 0.03
        squares = np.einsum("ki,kij,kj->k", errors, graph.information[pairs], errors)
        assert squares.max() < 25, "none is off by more than it claims"
        assert np.quantile(np.abs(errors[:, 2]), 0.95) < 0.01


def test_no_scan_is_moved_farther_from_the_key_scans_trajectory_than_allowed(halls):
    one = halls[0]
    bent = full_trajectory(one.refinement.best.graph.poses, one.recorder.keys, one.recorder.key_from_base)
    moved = np.hypot(*(one.refinement.poses - bent)[:, :2].T)
    assert moved.max() <= 0.15
    assert 0 < np.median(moved[moved > 0]) < 0.05
