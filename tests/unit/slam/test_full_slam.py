"""The full answer: the final refinement's with loop closure, the best particle's past without."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from closure_errors import false_closures
from gridslam.config import build, override
from gridslam.geometry.se2 import between, compose
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import full_slam
from gridslam.slam.full_slam.full_trajectory import full_trajectory
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.state import RejectionReason
from support.loops import PROVOKED, loop_drive

OFF = override(PROVOKED, "loop_closure=false")


@pytest.fixture(scope="module")
def loop():
    return loop_drive()


def answered(config, measurements, on_progress=lambda: None):
    recorder = TrajectoryRecorder()
    rng = np.random.default_rng(0)
    state = run(measurements, build(config), rng=rng, observers=[recorder])
    drives = [recorder.tracked_scans()]
    answer = full_slam(state, drives, config.mapper, config.loop_closure, on_progress)
    return state, recorder, answer


@pytest.fixture(scope="module")
def closed(loop):
    return answered(PROVOKED, loop.measurements)


def test_loops_make_the_end_as_certain_as_what_it_was_matched_to(loop, closed):
    _, _, answer = closed
    _, _, alone = answered(OFF, loop.measurements)
    assert answer.covariances.shape == alone.covariances.shape == (len(loop.measurements), 3, 3)
    assert (np.linalg.eigvalsh(answer.covariances)[1:] > 0).all()
    assert answer.covariances[-1].trace() < 0.2 * alone.covariances[-1].trace()


def test_closures_are_recognized_constraints_and_true(loop, closed):
    _, recorder, answer = closed
    loops = answer.loop_summary
    assert len(loops.closures) >= loops.constraints[ConstraintSource.RECOGNIZED] > 0  # more at the end
    assert loops.removed == 0
    assert (
        loops.refinement_constraints == len(answer.graph.edges) - len(answer.graph.poses) + 1 - len(loops.closures) > 0
    )
    assert set(loops.rejected) <= set(RejectionReason)
    key_scans = np.flatnonzero(np.diff(recorder.keys, prepend=-1))
    tied = {tuple(edge): z for edge, z in zip(answer.graph.edges.tolist(), answer.graph.measurements, strict=True)}
    measured = [tied[tuple(pair)] for pair in loops.closures.tolist()]
    assert not false_closures(loop.truth.poses[key_scans], loops.closures, measured).any()


def test_final_refinement_ticks_and_can_be_interrupted(loop):
    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answered(PROVOKED, loop.measurements[:150], stop)


def walk(rng, scans):
    """Poses (N, 3) of a random drive."""
    steps = rng.normal([0.1, 0.0, 0.0], [0.1, 0.02, 0.05], (scans, 3))
    poses = [np.array([1.0, -2.0, 3.0])]
    for step in steps[1:]:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def tracked(poses, starts):
    """`keys` and `key_from_base` as the reports give them: seen from the key scan before each scan."""
    keys = np.searchsorted(starts, np.arange(len(poses)), side="right") - 1
    since = np.concatenate([[0], keys[:-1]])  # a key scan itself is seen from the one before it
    return keys, between(poses[starts][since], poses)


@st.composite
def drives(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scans = draw(st.integers(1, 40))
    starts = np.flatnonzero(np.concatenate([[True], rng.random(scans - 1) < draw(st.sampled_from([0.1, 0.5, 1.0]))]))
    return walk(rng, scans), starts, rng


@given(drives())
@settings(deadline=None, max_examples=60)
def test_what_is_tracked_exactly_stays_exact(drive):
    poses, starts, _ = drive
    keys, key_from_base = tracked(poses, starts)
    bent = full_trajectory(poses[starts], keys, key_from_base)
    np.testing.assert_allclose(between(poses, bent), 0.0, atol=1e-9)


@given(drives())
@settings(deadline=None, max_examples=60)
def test_it_does_not_matter_where_the_map_lies(drive):
    poses, starts, rng = drive
    keys, key_from_base = tracked(poses, starts)
    given_poses = compose(poses[starts], rng.normal(0, 0.1, (len(starts), 3)))
    moved = rng.normal(0, [5.0, 5.0, 2.0], 3)
    here = full_trajectory(given_poses, keys, key_from_base)
    there = full_trajectory(compose(moved, given_poses), keys, key_from_base)
    np.testing.assert_allclose(between(compose(moved, here), there), 0.0, atol=1e-9)


def test_the_error_is_shared_in_proportion_to_the_motion():
    """1 m ahead in steps of 0.1, 0.3, 0.2 and 0.4 m, and the next key pose 0.1 m farther and 0.02 m aside."""
    along = np.array([0.0, 0.1, 0.4, 0.6, 1.0])
    key_from_base = np.column_stack([along, np.zeros(5), np.zeros(5)])
    bent = full_trajectory(np.array([[0.0, 0, 0], [1.1, 0.02, 0]]), np.array([0, 0, 0, 0, 1]), key_from_base)
    np.testing.assert_allclose(bent, np.column_stack([1.1 * along, 0.02 * along, np.zeros(5)]), atol=1e-12)


def test_after_the_last_key_scan_the_tracked_motion_stands():
    key_from_base = np.array([[0.0, 0, 0], [0.5, 0, 0], [0.1, 0, 0], [0.3, 0.1, 0.2]])
    bent = full_trajectory(np.array([[0.0, 0, 0], [0.6, 0.1, 0.1]]), np.array([0, 1, 1, 1]), key_from_base)
    np.testing.assert_allclose(bent[2:], compose([0.6, 0.1, 0.1], key_from_base[2:]), atol=1e-12)
