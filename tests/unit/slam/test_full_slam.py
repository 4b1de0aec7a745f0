"""The full answer: the final refinement's with loop closure, the best particle's past without."""

import numpy as np
import pytest

from closure_errors import false_closures
from gridslam.config import build, override
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import full_slam
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
