"""First two moments of the motion models against closed forms worked out by hand, and of their samples against both."""

import math

import checks
import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.models import DiffusionMotion, GMappingMotion, OdometryMotion, VelocityMotion

ORIGIN = np.zeros((1, 3))
NO_TURN = {"alpha1": 0.01, "alpha2": 0.02, "alpha3": 0.03, "alpha4": 0.04}


def covariance(sampler, pose=(0.0, 0.0, 0.0)):
    return sampler.moments(np.array([pose]))[1][0]


# rot1 = rot2 = 0, trans = 1: var(rot) = alpha2 each, var(trans) = alpha3; y moves with rot1 by +-1 m/rad.
@pytest.mark.parametrize(("direction", "sign"), [(1.0, 1.0), (-1.0, -1.0)])
def test_odometry_one_metre_straight(direction, sign):
    got = covariance(OdometryMotion(**NO_TURN)(np.array([direction, 0.0, 0.0])))
    np.testing.assert_allclose(got, [[0.03, 0, 0], [0, 0.02, sign * 0.02], [0, sign * 0.02, 0.04]], atol=1e-15)


def test_odometry_rotates_covariance_into_the_world():
    got = covariance(OdometryMotion(**NO_TURN)(np.array([1.0, 0.0, 0.0])), (3.0, 4.0, math.pi / 2))
    np.testing.assert_allclose(got, [[0.02, 0, -0.02], [0, 0.03, 0], [-0.02, 0, 0.04]], atol=1e-15)


def test_odometry_backward_is_not_two_half_turns():
    only_rotation = OdometryMotion(alpha1=1.0, alpha2=0.0, alpha3=0.0, alpha4=1.0)
    assert np.abs(covariance(only_rotation(np.array([-1.0, 0.0, 0.0])))).max() == 0.0


# 1 mm sideways while turning half a radian: var(rot2) = alpha1 / 4 + alpha2 1e-6, var(rot1) = alpha2 1e-6,
# var(trans) = alpha3 1e-6 + alpha4 / 4, along the direction of the jitter, -y.
def test_odometry_turn_on_the_spot_ignores_the_direction_of_jitter():
    sampler = OdometryMotion(**NO_TURN)(np.array([0.0, -0.001, 0.5]))
    means, covariances = sampler.moments(ORIGIN)
    np.testing.assert_allclose(means[0], [0.0, -0.001, 0.5], atol=1e-15)
    np.testing.assert_allclose(np.diag(covariances[0]), [2e-14, 0.01 + 3e-8, 0.0025 + 4e-8], rtol=1e-9)


# omega = 0: x = v dt, y = v omega dt^2 / 2, theta = (omega + gamma) dt.
def test_velocity_straight_line_limit():
    model = VelocityMotion(alpha1=0.01, alpha2=0, alpha3=0.02, alpha4=0, alpha5=0.03, alpha6=0)
    means, covariances = model(np.array([1.0, 0.0, 2.0])).moments(ORIGIN)
    np.testing.assert_allclose(means[0], [2.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(covariances[0], [[0.04, 0, 0], [0, 0.08, 0.08], [0, 0.08, 0.2]], atol=1e-12)


# Quarter circle of radius 1: d/dv = [2/pi, 2/pi, 0], d/domega = [-2/pi, 1 - 2/pi, 1], d/dgamma = [0, 0, 1].
@pytest.mark.parametrize(
    ("alpha", "direction"),
    [
        ("alpha1", [2 / math.pi, 2 / math.pi, 0]),
        ("alpha3", [-2 / math.pi, 1 - 2 / math.pi, 1]),
        ("alpha5", [0, 0, 1]),
    ],
)
def test_velocity_quarter_circle(alpha, direction):
    alphas = {f"alpha{i}": 0.0 for i in range(1, 7)} | {alpha: 0.01}
    speed = math.pi / 2
    means, covariances = VelocityMotion(**alphas)(np.array([speed, speed, 1.0])).moments(ORIGIN)
    np.testing.assert_allclose(means[0], [1.0, 1.0, math.pi / 2], atol=1e-14)
    np.testing.assert_allclose(covariances[0], 0.01 * speed**2 * np.outer(direction, direction), atol=1e-14)


@pytest.mark.parametrize("omega", [1e-4, 1.01e-5, 0.99e-5, 1e-9, 1e-300, -1e-9, -0.99e-5, -1.01e-5])
def test_velocity_is_continuous_at_the_straight_line(omega):
    model = VelocityMotion()
    straight, curved = model(np.array([1.0, 0.0, 1.0])), model(np.array([1.0, omega, 1.0]))
    # Every entry of increment and Jacobian changes by at most |omega| m/rad there, plus rounding (eps / 1e-5).
    np.testing.assert_allclose(curved.increment, straight.increment, atol=abs(omega) * 1.01 + 1e-15)
    np.testing.assert_allclose(curved.jacobian, straight.jacobian, atol=abs(omega) + 1e-10)


# By hand: x 0.1*0.5 + 0.3*0.1 + 0.03*0.2, y 0.1*0.2 + 0.3*0.1 + 0.03*0.5, theta 0.4*0.1 + 0.2*sqrt(0.29).
def test_gmapping_standard_deviations():
    got = covariance(GMappingMotion(srr=0.1, srt=0.2, str=0.3, stt=0.4)(np.array([0.5, -0.2, 0.1])))
    np.testing.assert_allclose(got, np.diag([0.086**2, 0.065**2, (0.04 + 0.2 * math.sqrt(0.29)) ** 2]), atol=1e-15)


# 5 m + 1 rad: variances 6 * 0.02^2 and 6 * 0.01^2, plus the squared floors.
def test_diffusion_variances():
    model = DiffusionMotion(sigma_xy_m=0.02, sigma_theta_rad=0.01, floor_xy_m=0.003, floor_theta_rad=0.002)
    got = covariance(model(np.array([3.0, -4.0, 1.0])))
    np.testing.assert_allclose(np.diag(got), [0.002409, 0.002409, 0.000604], rtol=1e-12)


@pytest.mark.parametrize("pieces", [2, 10])
def test_diffusion_does_not_depend_on_how_a_path_is_cut(pieces):
    model = DiffusionMotion(floor_xy_m=0.0, floor_theta_rad=0.0)
    whole = model(np.array([1.0, 0.0, 0.2])).std ** 2
    piece = model(np.array([1.0, 0.0, 0.2]) / pieces).std ** 2
    np.testing.assert_allclose(pieces * piece, whole, rtol=1e-12)


ALPHAS = {f"alpha{i}": 1e-4 * i for i in range(1, 7)}
ODOMETRY = OdometryMotion(**{k: ALPHAS[k] for k in NO_TURN})


@pytest.mark.parametrize(
    "sampler",
    [
        ODOMETRY(np.array([0.5, 0.2, 0.4])),
        ODOMETRY(np.array([-0.5, 0.1, -0.3])),
        ODOMETRY(np.array([0.002, -0.003, 0.6])),
        VelocityMotion(**ALPHAS)(np.array([0.8, 0.5, 0.7])),
        VelocityMotion(**ALPHAS)(np.array([0.8, 0.0, 0.7])),
        GMappingMotion(srr=0.01, srt=0.02, str=0.01, stt=0.02)(np.array([0.5, 0.2, 0.4])),
        DiffusionMotion()(np.array([0.5, 0.2, 0.4])),
    ],
    ids=["odometry", "odometry-backward", "odometry-turn", "velocity-arc", "velocity-line", "gmapping", "diffusion"],
)
def test_samples_have_the_first_order_moments(sampler):
    before = np.array([3.0, -2.0, 3.0])  # heading near pi: samples fall on both sides of the seam
    (mean,), (spread,) = sampler.moments(before[None])
    checks.samples_have_moments(sampler, before, mean, spread)


def test_noise_is_independent_between_particles():
    n = 50_000
    poses = np.zeros((2 * n, 3))
    steps = between(poses, DiffusionMotion()(np.array([1.0, 0.0, 0.0]))(poses, np.random.default_rng(3)))[:, 1]
    # The correlation of n independent pairs has standard error 1 / sqrt(n).
    assert abs(np.corrcoef(steps[:n], steps[n:])[0, 1]) < 5 / math.sqrt(n)
