"""Systematic errors of odometry as unknowns: the derivatives, the Gauss-Markov process, and what is not sought."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridslam.models.motion import DiffusionMotion, GaussianIncrement
from gridslam.models.systematic_errors import NO_ERRORS, SystematicErrors

increments = st.tuples(st.floats(-2, 2), st.floats(-0.5, 0.5), st.floats(-1, 1)).map(np.array)
places, errors = st.floats(-50, 50), st.floats(-0.1, 0.1)
beliefs = st.tuples(places, places, st.floats(-3, 3), errors, errors)


@given(known=beliefs.map(np.array), increment=increments)
def test_the_jacobian_is_the_derivative(known, increment):
    bias, motion, step = SystematicErrors(), DiffusionMotion()(increment), 1e-5
    _, (F,), _ = bias.predict(motion, known[None])
    for k, change in enumerate(np.eye(5) * step):
        ends = [bias.predict(motion, (known + s)[None])[0][0] for s in (change, -change)]
        slope = ends[0] - ends[1]
        slope[2] = np.remainder(slope[2] + np.pi, 2 * np.pi) - np.pi
        # Rounding, 1e-14 of coordinates up to 50 over the step, and a third derivative of at most 2 times step^2 / 6.
        np.testing.assert_allclose(F[:, k], slope / (2 * step), atol=2e-8)


@given(known=beliefs.map(np.array), increment=increments)
def test_odometry_that_turns_too_little_is_corrected_by_what_it_turns_too_little(known, increment):
    exact = GaussianIncrement.from_std(increment, np.zeros(3))
    told = GaussianIncrement.from_std(increment - [0, 0, known[3] * increment[0]], np.zeros(3))
    known[4] = 0.0
    ((*moved, _, _),), _, _ = SystematicErrors().predict(told, known[None])
    away = np.array(moved) - exact.moments(known[None, :3])[0][0]
    np.testing.assert_allclose(away[:2], 0.0, atol=1e-12)
    np.testing.assert_allclose(np.sin(away[2] / 2), 0.0, atol=1e-12)


def test_odometry_that_is_held_for_exact_moves_as_the_motion_model_says():
    motion, poses = DiffusionMotion()(np.array([0.5, 0.1, 0.2])), np.array([[1.0, 2.0, 3.0], [0.0, 0.0, -1.0]])
    moved, F, Q = NO_ERRORS.predict(motion, poses)
    means, noise = motion.moments(poses)
    assert len(NO_ERRORS) == 0
    np.testing.assert_array_equal(moved, means)
    np.testing.assert_array_equal(Q, noise)
    assert F.shape == (2, 3, 3)


@given(way=st.floats(0.1, 500), parts=st.integers(1, 5))
def test_errors_are_a_stationary_process_of_the_way_however_it_is_cut(way, parts):
    """Nothing is learned, so their covariance stays; what is known exactly decays by the way, not by the steps."""
    bias, increment = SystematicErrors(memory_m=100.0), np.array([way / parts, 0.0, 0.0])
    motion = GaussianIncrement.from_std(increment, np.zeros(3))
    known, P, sure = np.array([[0.0, 0.0, 0.0, 0.002, -0.01]]), bias.covariance(), np.zeros((2, 2))
    for _ in range(parts):
        known, (F,), (Q,) = bias.predict(motion, known)
        P, sure = (F[3:, 3:] @ C @ F[3:, 3:].T + Q[3:, 3:] for C in (P, sure))
    np.testing.assert_allclose(P, bias.covariance(), rtol=1e-9)
    np.testing.assert_allclose(known[0, 3:], np.exp(-way / 100.0) * np.array([0.002, -0.01]), rtol=1e-9)
    np.testing.assert_allclose(sure, -np.expm1(-2 * way / 100.0) * bias.covariance(), rtol=1e-6, atol=1e-15)
