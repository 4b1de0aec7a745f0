"""One pose as a tuple: the same numbers as the arrays of se2, bit for bit."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridslam.geometry import se2, single_pose

METRES = st.floats(-1e4, 1e4)
POSES = st.tuples(METRES, METRES, st.floats(-math.pi, math.pi, exclude_max=True))
TWISTS = st.tuples(METRES, METRES, st.floats(-3 * math.pi, 3 * math.pi))


@given(POSES, POSES)
def test_compose_and_between_are_those_of_se2(a, b):
    assert single_pose.compose(a, b) == tuple(se2.compose(a, b).tolist())
    assert single_pose.between(a, b) == tuple(se2.between(a, b).tolist())


@given(POSES, TWISTS)
def test_exp_and_log_are_those_of_se2(pose, twist):
    assert single_pose.exp(twist) == tuple(se2.exp(twist).tolist())
    assert single_pose.log(pose) == tuple(se2.log(pose).tolist())


def test_a_pose_that_nobody_measured_stays_unknown():
    assert not single_pose.is_known(single_pose.UNKNOWN_POSE)
    assert not single_pose.is_known(single_pose.between(single_pose.UNKNOWN_POSE, (1.0, 2.0, 3.0)))
    assert single_pose.is_known(single_pose.as_pose(np.zeros(3)))
