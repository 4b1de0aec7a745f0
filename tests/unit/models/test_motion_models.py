import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose
from gridslam.models import DiffusionMotion, GMappingMotion, OdometryMotion, VelocityMotion
from gridslam.models.motion import GaussianIncrement

MODELS = [OdometryMotion, GMappingMotion, DiffusionMotion, VelocityMotion]
SILENT = [
    OdometryMotion(alpha1=0, alpha2=0, alpha3=0, alpha4=0),
    GMappingMotion(srr=0, srt=0, str=0, stt=0),
    DiffusionMotion(sigma_xy_m=0, sigma_theta_rad=0, floor_xy_m=0, floor_theta_rad=0),
]
METRES = st.floats(-5, 5)
HEADINGS = st.floats(-math.pi, math.pi, exclude_max=True)


@pytest.mark.parametrize("model", SILENT, ids=lambda model: type(model).__name__)
@given(x=METRES, y=METRES, theta=HEADINGS, heading=HEADINGS)
def test_without_noise_a_sample_is_the_composed_increment(model, x, y, theta, heading):
    increment, poses = np.array([x, y, theta]), np.array([[1.0, -2.0, heading], [0.0, 0.0, 0.5]])
    sampler = model(increment)
    expected = compose(poses, increment)
    for got in (sampler(poses, np.random.default_rng(0)), sampler.moments(poses)[0]):
        assert np.abs(got[:, :2] - expected[:, :2]).max() < 1e-12
        assert np.abs(wrap(got[:, 2] - expected[:, 2])).max() < 1e-12


@given(v=st.floats(-2, 2), omega=st.floats(-6, 6), dt=st.floats(0, 2))
def test_without_noise_velocity_follows_the_circle(v, omega, dt):
    model = VelocityMotion(alpha1=0, alpha2=0, alpha3=0, alpha4=0, alpha5=0, alpha6=0)
    got = model(np.array([v, omega, dt]))(np.zeros((1, 3)), np.random.default_rng(0))[0]
    # The arc as 2000 chords at mid headings: each is short of its arc by (omega h)^2 / 24 of its length.
    h = dt / 2000
    headings = omega * h * (np.arange(2000) + 0.5)
    reference = [v * h * np.cos(headings).sum(), v * h * np.sin(headings).sum()]
    assert np.abs(got[:2] - reference).max() <= abs(v) * dt * (omega * h) ** 2 / 24 + 1e-12
    assert abs(wrap(got[2] - omega * dt)) < 1e-12


@pytest.mark.parametrize("model", MODELS)
def test_same_generator_same_bytes_and_poses_untouched(model):
    poses = np.random.default_rng(1).normal(size=(30, 3))
    before = poses.copy()
    sampler = model()(np.array([0.3, 0.1, 0.2]))
    first, second = (sampler(poses, np.random.default_rng(5)) for _ in range(2))
    assert first.tobytes() == second.tobytes()
    assert poses.tobytes() == before.tobytes()
    assert first.tobytes() != sampler(poses, np.random.default_rng(6)).tobytes()


def test_time_does_not_run_backward():
    with pytest.raises(ArgumentError, match="dt >= 0"):
        VelocityMotion()(np.array([1.0, 0.0, -0.1]))


def test_a_translation_just_short_of_still_keeps_its_mean():
    model = OdometryMotion(still_m=0.01)
    for length in (0.0099, 0.0101):
        means, _ = model(np.array([0.0, length, 0.0])).moments(np.zeros((1, 3)))
        np.testing.assert_allclose(means[0], [0.0, length, 0.0], atol=1e-15)


def test_many_poses_have_the_covariances_of_each_alone():
    rng = np.random.default_rng(4)
    root, poses = rng.normal(size=(3, 3)), rng.normal(size=(150, 3))
    motion = GaussianIncrement.with_covariance(rng.normal(size=3), root @ root.T)
    alone = np.concatenate([motion.moments(pose[None])[1] for pose in poses])
    np.testing.assert_allclose(motion.moments(poses)[1], alone, atol=1e-12)
