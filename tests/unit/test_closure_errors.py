"""Closures are judged by the true relative pose, wherever the map lies and however it is turned."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from closure_errors import closure_errors, false_closures
from gridslam.geometry.se2 import between, compose

TRUTH = np.array([[0.0, 0.0, 0.0], [2.0, 1.0, math.pi / 2], [2.0, 4.0, math.pi - 0.01], [-1.0, 0.0, -3.0]])
reals = st.floats(-50, 50)
poses = st.tuples(reals, reals, st.floats(-math.pi, math.pi))


def test_errors_by_hand():
    # From (2, 1), looking along y, the place (2, 4) is 3 m ahead.
    metres, radians = closure_errors(TRUTH, [[1, 2], [1, 2]], [[3.0, 0.0, math.pi / 2], [3.3, 0.4, math.pi / 2 - 0.21]])
    assert metres == pytest.approx([0.0, 0.5])
    assert radians == pytest.approx([0.01, 0.2])


@given(frame=poses, error=st.tuples(st.floats(-9, 9), st.floats(-9, 9), st.floats(-3.1, 3.1)))
def test_the_frame_does_not_matter_and_the_error_is_what_was_added(frame, error):
    edges = np.array([[0, 3], [2, 1], [3, 2]])
    measured = between(TRUTH[edges[:, 0]], TRUTH[edges[:, 1]]) + error
    metres, radians = closure_errors(compose(np.array(frame), TRUTH), edges, measured)
    assert metres == pytest.approx(np.full(3, math.hypot(error[0], error[1])), abs=1e-9)
    assert radians == pytest.approx(np.full(3, abs(error[2])), abs=1e-9)


def test_false_is_more_than_half_a_metre_or_five_degrees():
    edges = np.tile([0, 1], (5, 1))
    off = [(0, 0, 0), (0.29, 0.4, 0), (0.31, 0.4, 0), (0, 0, math.radians(-4.9)), (0.1, 0, math.radians(5.1))]
    measured = TRUTH[1] + np.array(off)
    assert false_closures(TRUTH, edges, measured).tolist() == [False, False, True, False, True]
    assert not false_closures(TRUTH, edges, measured, tolerance_m=1.0, tolerance_rad=0.1).any()


@pytest.mark.parametrize("turn", [0.0, 0.7, math.pi / 2])
def test_along_an_open_direction_nothing_is_false(turn):
    """A corridor along x of the frame in which the measurement begins; the information is of the one where it ends."""
    c, s = math.cos(turn), math.sin(turn)
    across = np.array([s, c])  # the corridor's y axis, seen turned by `turn`
    information = np.zeros((1, 3, 3))
    information[0, :2, :2] = 1e3 * np.outer(across, across) + 1e-2 * np.eye(2)
    information[0, 2, 2] = 1e3
    truth = [[0.0, 0.0, 0.0], [3.0, 1.0, turn]]
    for along, off in ((7.0, 0.0), (0.0, 0.4), (-7.0, -0.6)):
        metres, _ = closure_errors(truth, [[0, 1]], [[3.0 + along, 1.0 + off, turn]], information)
        assert metres == pytest.approx([abs(off)], abs=1e-9)
        told = false_closures(truth, [[0, 1]], [[3.0 + along, 1.0 + off, turn]], information)
        assert told.tolist() == [abs(off) > 0.5]
    assert closure_errors(truth, [[0, 1]], [[10.0, 1.0, turn]])[0] == pytest.approx([7.0])
