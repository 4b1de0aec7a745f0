"""The final refinement: no worse than the filter's trajectory, and just what was tracked where nothing ties it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gridslam.evaluation import absolute_errors
from gridslam.geometry.se2 import between, compose, rotate_covariances
from gridslam.matching.surfaces import Surfaces
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import OdometryNoise, SimulatedLog
from gridslam.slam import GridFastSlam
from gridslam.slam.full_slam import global_scan_refinement
from gridslam.slam.full_slam.full_trajectory import full_trajectory
from gridslam.slam.full_slam.global_scan_refinement import RefinementResult, _Refinement, refine_trajectory
from gridslam.slam.full_slam.surface_adjustment import LINE_REACH_M
from gridslam.slam.full_slam.trajectory_score import score_trajectory
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submaps import build_map
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


def prepare_refinement(state: LoopClosureState) -> _Refinement:
    """A refinement that has not begun."""
    batch = state.scans.batch(state.scans.keys)
    surfaces, fives = Surfaces.of(batch, LINE_REACH_M), Surfaces.of(batch)
    return _Refinement(
        state, surfaces, fives, SLAM.mapper, CLOSURE, lambda: None, [], 0, state.pairs.copy(), SubmapPairs()
    )


def absolute_errors_of_keys(run: Refined, poses: np.ndarray) -> float:
    keys = run.state.closure_state.scans.keys
    truth = Trajectory(run.log.truth.stamps_ns[keys], run.log.truth.poses[keys])
    return absolute_errors(Trajectory(truth.stamps_ns, poses), truth).trans_rmse_m


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


def test_key_scans_stay_where_an_adjustment_tears_them_apart(loop, monkeypatch):
    """As it does where a few beams show too little of the surfaces."""
    rng = np.random.default_rng(0)

    def tear(measured, surfaces, fives, components, threads=1):
        poses = measured.poses.copy()
        poses[len(poses) // 2 :, :2] += rng.normal(0, 1.0, 2)
        return measured.with_poses(poses), 4e-4

    monkeypatch.setattr(global_scan_refinement, "adjust_key_scans", tear)
    trajectory = loop.state.ancestry.trajectory(loop.state.best)
    drives = [loop.recorder.tracked_scans()]
    refined = refine_trajectory(loop.state.closure_state.snapshot(), trajectory, drives, SLAM.mapper, CLOSURE)
    assert absolute_errors_of_keys(loop, refined.best.graph.poses) < absolute_errors_of_keys(loop, trajectory) + 0.05


def test_recognized_places_that_make_a_trajectory_worse_are_not_taken_over(loop, monkeypatch):
    """Though the trajectory agrees with each of them."""
    state = loop.state.closure_state.snapshot()
    trajectory = loop.state.ancestry.trajectory(loop.state.best)
    refinement = prepare_refinement(state)
    alone = refinement._keep_trajectory("filter", trajectory, [])
    before = refinement.adjust(alone)
    place = Constraint(0, 20, between(trajectory[0], trajectory[20]), np.eye(3), ConstraintSource.RECOGNIZED, True)
    for worse in (1.5, 0.5):  # nats; one is worth no more than a bare mention
        likelihood = before.score.log_likelihood - worse
        monkeypatch.setattr(_Refinement, "_log_likelihood", lambda self, joined, value=likelihood: value)
        taken = refinement._take_over(alone, [place])
        assert taken.recognized_constraints == ([] if worse > 1 else [place])
        assert state.graph.constraints == taken.constraints
        assert (refinement.adjusted.get("filter") is before) is (worse > 1)
        refinement.adjusted["filter"] = before


def test_tracked_revisits_are_apart(loop):
    """One every metre, or half a radian: those between would measure the same."""
    graph = loop.state.closure_state.graph
    tracked = [c.to for c in graph.constraints if c.source is ConstraintSource.TRACKED and c.determined]
    x, y, turn = between(np.array(graph.tracked)[tracked[:-1]], np.array(graph.tracked)[tracked[1:]]).T
    assert len(tracked) > 5
    assert ((np.hypot(x, y) >= 1.0) | (np.abs(turn) >= 0.5)).all()


def test_no_scan_is_moved_farther_from_the_key_scans_trajectory_than_allowed(halls):
    one = halls[0]
    bent = full_trajectory(one.refinement.best.graph.poses, one.recorder.keys, one.recorder.key_from_base)
    moved = np.hypot(*(one.refinement.poses - bent)[:, :2].T)
    assert moved.max() <= 0.15
    assert 0 < np.median(moved[moved > 0]) < 0.05


DRIFT = DriftModel()


class Log:
    """Key scans as loop closure keeps them, tracked without error."""

    def __init__(self, truth, beams, tracked=None):
        tracked = truth if tracked is None else tracked
        self.truth, self.graph, self.scans = truth, KeyGraph(), ScanArchive()
        for k, (pose, seen) in enumerate(zip(tracked, beams, strict=True)):
            x, y, turn = between(tracked[k - 1], pose) if k else np.zeros(3)
            self.scans.append(seen, pose, is_key=True)
            self.graph.extend(pose, pose, DRIFT.variances(math.hypot(x, y), abs(turn)))

    def score(self, poses):
        return score_trajectory(self.graph, self.scans, poses, hall.MAPPER)


@pytest.fixture(scope="module")
def seen():
    return hall.key_scans(hall.drive(0))


@pytest.fixture(scope="module")
def returning(seen):
    """Two laps of 56 m."""
    return Log(seen.truth, seen.beams)


@pytest.fixture(scope="module")
def true(returning):
    return returning.score(returning.truth)[0]


def shifted(poses, offset):
    """The second half of the poses is elsewhere in the map."""
    half = len(poses) // 2
    return np.concatenate([poses[:half], poses[half:] + np.array(offset)])


@pytest.mark.parametrize("offset", [(0.3, 0.0, 0.0), (0.0, -0.3, 0.0), (2.0, 0.0, 0.0), (0.0, 2.0, 0.0)])
def test_a_second_visit_that_is_put_beside_the_first_scores_less(returning, true, offset):
    """Both as to what is seen and as to how the robot moved.

    The scans alone decide it, although walls along the shift, half of them, agree as before.
    """
    wrong, _ = returning.score(shifted(returning.truth, offset))
    assert wrong.log_likelihood < true.log_likelihood
    assert wrong.motion < true.motion
    assert wrong.agreement < true.agreement - 0.1
    assert wrong.log_likelihood - wrong.motion < 0.5 * (true.log_likelihood - true.motion)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)])
def test_the_map_is_that_of_all_key_scans(returning, offset):
    poses = shifted(returning.truth, offset)
    _, maps = returning.score(poses)
    whole = build_map(hall.MAPPER, returning.scans, np.arange(len(poses)), poses)
    given, expected = maps.to_arrays(), whole.to_arrays()
    assert given.keys() == expected.keys()
    assert {n: a.tobytes() for n, a in given.items()} == {n: a.tobytes() for n, a in expected.items()}


def test_the_motion_is_a_cauchy_density_from_submap_to_submap(returning):
    """One that is off costs log(1 + squared Mahalanobis distance), tempered; each step's heading turns what follows."""
    tracked, variances = np.array(returning.graph.tracked), np.array(returning.graph.variances)
    for begin, off in ((20, (0.1, 0.0, 0.0)), (50, (0.0, 0.0, -0.02)), (100, (-0.2, 0.1, 0.01))):
        end = begin + KEY_SCANS_PER_SUBMAP
        moved_end = compose(tracked[end], np.array(off))
        poses = np.concatenate([tracked[:end], compose(moved_end, between(tracked[end], tracked[end:]))])
        x, y, theta = tracked[end]
        covariance = np.zeros((3, 3))
        for k in range(begin + 1, end + 1):
            position, heading = variances[k]
            across = np.array([tracked[k][1] - y, x - tracked[k][0], 1.0])
            covariance += np.diag([position, position, 0.0]) + heading * np.outer(across, across)
        error = rotate_covariances(np.outer(off, off), theta)  # in the axes of the map
        squared = np.trace(np.linalg.solve(covariance, error))
        expected = -0.5 * math.log1p(squared)
        assert returning.score(poses)[0].motion == pytest.approx(expected, rel=1e-6)


def test_a_loop_left_open_by_drift_scores_less_than_the_truth_although_its_motion_is_the_tracked_one(seen):
    """0.01 rad/m: after a lap everything is half a radian off. Walls mapped twice outweigh the motion."""
    bent = hall.tracked(seen.truth, bias_rad_per_m=0.01)
    log = Log(seen.truth, seen.beams, bent)
    closed, _ = log.score(seen.truth)
    left_open, _ = log.score(bent)
    assert left_open.motion == 0 > closed.motion
    assert closed.log_likelihood > left_open.log_likelihood
