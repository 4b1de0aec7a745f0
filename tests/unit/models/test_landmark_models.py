"""Models of landmarks: Jacobians against finite differences, and the inverse against the model itself."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose
from gridslam.models.landmark import (
    NO_OBSERVATIONS,
    DepthBearing,
    LandmarkModel,
    LandmarkObservations,
    LandmarkStep,
    RangeBearing,
    RelativePosition,
)
from gridslam.models.motion import OdometryMotion
from gridslam.types import MotionSampler

MODELS = [RangeBearing(), DepthBearing(), RelativePosition()]
poses = st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-3.1, 3.1)).map(np.array)
offsets = st.tuples(st.floats(0.5, 30), st.floats(-3.1, 3.1)).map(
    lambda p: p[0] * np.array([np.cos(p[1]), np.sin(p[1])])
)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@given(pose=poses, offset=offsets)
def test_jacobians_are_the_derivatives(model, pose, offset):
    landmark, step = pose[:2] + offset, 1e-5
    predicted, by_pose, by_landmark = model.linearize(pose, landmark)
    for jacobian, at in ((by_pose, 0), (by_landmark, 1)):
        for k, change in enumerate(np.eye(3 - at) * step):
            ends = [
                model.linearize(*((pose + s, landmark) if at == 0 else (pose, landmark + s)))[0]
                for s in (change, -change)
            ]
            slope = model.residual(*ends) / (2 * step)
            # Central differences err by step^2 / 6 times a third derivative, at most 2 / range^3 = 16: by 3e-10, and by
            # rounding: some 1e-14 of coordinates up to 80 over the step, 1e-7.
            np.testing.assert_allclose(jacobian[:, k], slope, atol=2e-7)
    assert isinstance(model, LandmarkModel)
    assert predicted.shape == (2,)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
@given(pose=poses, offset=offsets)
def test_a_landmark_is_located_where_it_is_seen(model, pose, offset):
    predicted = model.linearize(pose, pose[:2] + offset)[0]
    np.testing.assert_allclose(model.locate(pose, predicted), pose[:2] + offset, atol=1e-10)


def test_noise_is_the_sightings_own_where_they_have_any():
    model, seen = RangeBearing(sigma_range_m=0.5, sigma_bearing_rad=0.1), [[1.0, 0.0], [2.0, 0.0]]
    np.testing.assert_allclose(model.noise(LandmarkObservations.of(seen)), [[[0.25, 0], [0, 0.01]]] * 2)
    own = [[[1, 0.5], [0.5, 1]], [[2, 0], [0, 3]]]
    np.testing.assert_array_equal(model.noise(LandmarkObservations.of(seen, [1, 2], own)), own)


def test_a_step_moves_with_its_own_covariance():
    root = np.array([[0.2, 0, 0], [0.1, 0.05, 0], [-0.05, 0.02, 0.03]])
    step = LandmarkStep(0, np.array([1.0, 0.5, 0.4]), root @ root.T, NO_OBSERVATIONS)
    motion = step.motion(OdometryMotion())
    assert isinstance(motion, MotionSampler)
    pose = np.array([[3.0, -2.0, 1.2]])
    mean, covariance = motion.moments(pose)
    np.testing.assert_allclose(mean, compose(pose, step.increment))
    c, s = np.cos(1.2), np.sin(1.2)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(covariance[0], turn @ step.covariance @ turn.T, atol=1e-12)
    # The sample covariance of n draws errs by a share of about sqrt(2 / n): with 20,000 draws five of them are 5 %.
    drawn = motion(np.repeat(pose, 20_000, axis=0), np.random.default_rng(1)) - mean
    drawn[:, 2] = wrap(drawn[:, 2])
    np.testing.assert_allclose(drawn.T @ drawn / len(drawn), covariance[0], atol=0.05 * np.trace(covariance[0]))
