"""Motion models conditioned on the robot's increment, from odometry or scan matching, or on its velocity.

A model is called with an increment and returns a sampler for all particles at once. Every model here is a Gaussian over
a few parameters of the increment; the models differ in what the parameters are and how their noise grows with motion.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import compose, exp, rotate_covariances
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, MotionSampler, Poses


def _finite_triple(values: ArrayLike, name: str) -> tuple[float, float, float]:
    """Three finite numbers as floats; raises ArgumentError that names the argument otherwise."""
    array = np.asarray(values, dtype=np.float64)
    numbers = array.tolist()
    if array.shape != (3,) or not all(map(math.isfinite, numbers)):
        raise ArgumentError(name, "three finite numbers", numbers)
    a, b, c = numbers
    return a, b, c


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class GaussianIncrement:
    """Sampler of p(x_t | u_t, x_{t-1}) for an increment whose parameters carry independent Gaussian noise.

    Attributes
    ----------
    mean, std : (P,) float64
        Mean and standard deviation of the parameters, in the model's units.
    increment : (3,) float64
        The increment at the mean, [x m, y m, theta rad] in the frame of the pose before.
    jacobian : (3, P) float64
        Derivative of the increment by the parameters at the mean.
    to_increment : callable
        Maps parameters (N, P) to increments (N, 3).
    """

    mean: FloatArray
    std: FloatArray
    increment: FloatArray
    jacobian: FloatArray
    to_increment: Callable[[FloatArray], FloatArray] = lambda values: values

    @classmethod
    def from_std(cls, increment: Annotated[FloatArray, 3], std: Annotated[FloatArray, 3]) -> GaussianIncrement:
        """Return sampler with noise `std` (3,) directly on x, y (m) and theta (rad) of `increment` (3,)."""
        return cls(increment, std, increment, np.eye(3))

    @classmethod
    def with_covariance(
        cls, increment: Annotated[FloatArray, 3], covariance: Annotated[FloatArray, 3, 3]
    ) -> GaussianIncrement:
        """Return sampler with noise of a `covariance` (3, 3), by x, y (m) and theta (rad) of `increment` (3,)."""
        variances, axes = np.linalg.eigh(covariance)
        std = np.sqrt(np.maximum(variances, 0.0))
        return cls(np.zeros(3), std, increment, axes, lambda values: increment + values @ axes.T)

    def __call__(self, poses: Poses, rng: np.random.Generator) -> FloatArray:
        """Draw one successor (N, 3) for each pose (N, 3)."""
        values = rng.standard_normal((len(poses), len(self.mean)))
        for column, mean, std in zip(values.T, self.mean, self.std, strict=True):  # loops along the poses are long
            column *= std
            column += mean
        return compose(poses, self.to_increment(values))

    def moments(self, poses: Poses) -> tuple[FloatArray, FloatArray]:
        """Mean successors (N, 3) and covariances (N, 3, 3) in the world frame, to first order in the noise."""
        scaled = self.jacobian * self.std
        covariance = scaled @ scaled.T
        if len(poses) == 1:
            (pose,) = poses
            return compose(pose, self.increment)[None], rotate_covariances(covariance, pose[2])[None]
        return compose(poses, self.increment), rotate_covariances(covariance, poses[:, 2])


def add_noise(motion: MotionSampler, covariance: FloatArray) -> GaussianIncrement:
    """Return the same motion with noise of a covariance (3, 3) beside its own, in the frame of the pose before it."""
    (increment,), (own,) = motion.moments(np.zeros((1, 3)))
    return GaussianIncrement.with_covariance(increment, own + covariance)


def _rotate_translate_rotate(values: FloatArray) -> FloatArray:
    rot1, trans, rot2 = values.T
    return np.stack([trans * np.cos(rot1), trans * np.sin(rot1), rot1 + rot2], axis=-1)


@final
@checked
@parameters(frozen=True)
class OdometryMotion:
    """Odometry motion model: an increment is a rotation, a translation and a second rotation, each with its own noise.

    Driving backward is a negative translation: the first rotation stays within [-pi/2, pi/2], so that a robot that
    reverses is not charged for two rotations of pi. A translation below `still_m` has no meaningful direction: its
    noise is that of the turn alone, spent in the second rotation. The mean is the exact increment in all cases.

    Parameters
    ----------
    alpha1 : float, rad^2/rad^2, >= 0
        Variance of each rotation per squared rotation.
    alpha2 : float, rad^2/m^2, >= 0
        Variance of each rotation per squared translation.
    alpha3 : float, m^2/m^2, >= 0
        Variance of the translation per squared translation.
    alpha4 : float, m^2/rad^2, >= 0
        Variance of the translation per squared rotation.
    still_m : float, m, >= 0
        Translation below which the robot only turned; 1 cm is what odometry jitters by while turning on the spot.

    Notes
    -----
    The defaults are wide (standard deviations of a tenth of the motion): wheels slip, and a filter recovers from
    too much noise but not from too little.

    References
    ----------
    Probabilistic Robotics, Table 5.6 (`sample_motion_model_odometry`).
    """

    alpha1: float = bounded(0.01, ge=0, le=100)
    alpha2: float = bounded(0.01, ge=0, le=100)
    alpha3: float = bounded(0.01, ge=0, le=100)
    alpha4: float = bounded(0.01, ge=0, le=100)
    still_m: float = bounded(0.01, ge=0, le=1e6)

    def __call__(self, increment: Annotated[FloatArray, 3]) -> GaussianIncrement:
        """Condition on the increment (3,) [x m, y m, theta rad]; raises ArgumentError for other shapes or NaN."""
        x, y, theta = _finite_triple(increment, "increment")
        forward = math.copysign(1.0, x)
        trans = forward * math.hypot(x, y)
        rot1 = math.atan2(forward * y, abs(x))
        rot2 = math.remainder(theta - rot1, math.tau)
        noisy1, noisy2 = (0.0, theta) if abs(trans) < self.still_m else (rot1, rot2)
        variance = [
            self.alpha1 * noisy1**2 + self.alpha2 * trans**2,
            self.alpha3 * trans**2 + self.alpha4 * (noisy1**2 + noisy2**2),
            self.alpha1 * noisy2**2 + self.alpha2 * trans**2,
        ]
        c = math.cos(rot1)
        s = math.sin(rot1)
        jacobian = np.array([[-trans * s, c, 0.0], [trans * c, s, 0.0], [1.0, 0.0, 1.0]])
        mean = np.array([rot1, trans, rot2])
        return GaussianIncrement(mean, np.sqrt(variance), np.array([x, y, theta]), jacobian, _rotate_translate_rotate)


@final
@checked
@parameters(frozen=True)
class GMappingMotion:
    """GMapping's motion model: noise on x, y and theta of the increment, standard deviations linear in the motion.

    Because standard deviations, not variances, grow linearly, the noise of a path depends on how many increments it is
    cut into: condition on one increment for each filter step, not for each odometry reading.

    Parameters
    ----------
    srr : float, m/m, >= 0
        Translation noise per translation; 0.3 of it acts across the motion.
    srt : float, rad/m, >= 0
        Rotation noise per TRANSLATION (other programs read the two letters the other way round).
    str : float, m/rad, >= 0
        Translation noise per rotation.
    stt : float, rad/rad, >= 0
        Rotation noise per rotation.

    Notes
    -----
    The defaults are those of GMapping's ROS node.

    References
    ----------
    G. Grisetti, C. Stachniss, W. Burgard, GMapping (OpenSLAM), `MotionModel::drawFromMotion`.
    """

    srr: float = bounded(0.1, ge=0, le=100)
    srt: float = bounded(0.2, ge=0, le=100)
    str: float = bounded(0.1, ge=0, le=100)
    stt: float = bounded(0.2, ge=0, le=100)

    def __call__(self, increment: Annotated[FloatArray, 3]) -> GaussianIncrement:
        """Condition on the increment (3,) [x m, y m, theta rad]; raises ArgumentError for other shapes or NaN."""
        x, y, theta = _finite_triple(increment, "increment")
        across = 0.3 * self.srr
        turned = self.str * abs(theta)
        std = [
            self.srr * abs(x) + turned + across * abs(y),
            self.srr * abs(y) + turned + across * abs(x),
            self.stt * abs(theta) + self.srt * math.hypot(x, y),
        ]
        return GaussianIncrement.from_std(np.array([x, y, theta]), np.array(std))


@final
@checked
@parameters(frozen=True)
class DiffusionMotion:
    """Motion whose increment scan matching has already refined: a random walk with the same noise in every direction.

    The error left by scan matching has no memory, so variances, not standard deviations, grow linearly with the metres
    and radians moved: cutting a path into more increments does not change its noise (but for the floor).

    Parameters
    ----------
    sigma_xy_m : float, m, >= 0
        Standard deviation of x and of y after one metre or one radian; 2 cm served on the Intel and ACES logs.
    sigma_theta_rad : float, rad, >= 0
        Standard deviation of theta after one metre or one radian; 0.01 rad served there too.
    floor_xy_m, floor_theta_rad : float, m and rad, >= 0
        Standard deviation of an increment without motion, added in variance: particles at one place stay distinct
        by a fraction of what a match resolves (0.02 of a 5 cm cell and 2e-4 rad).

    References
    ----------
    D. Haehnel, W. Burgard, D. Fox, S. Thrun, An efficient FastSLAM algorithm for generating maps of large-scale
    cyclic environments from raw laser range measurements, IROS 2003 (its learned noise, here two constants).
    """

    sigma_xy_m: float = bounded(0.02, ge=0, le=100)
    sigma_theta_rad: float = bounded(0.01, ge=0, le=10)
    floor_xy_m: float = bounded(0.001, ge=0, le=100)
    floor_theta_rad: float = bounded(0.0002, ge=0, le=10)

    def __call__(self, increment: Annotated[FloatArray, 3]) -> GaussianIncrement:
        """Condition on the increment (3,) [x m, y m, theta rad]; raises ArgumentError for other shapes or NaN."""
        x, y, theta = _finite_triple(increment, "increment")
        root = math.sqrt(math.hypot(x, y) + abs(theta))
        xy = math.hypot(self.sigma_xy_m * root, self.floor_xy_m)
        std = np.array([xy, xy, math.hypot(self.sigma_theta_rad * root, self.floor_theta_rad)])
        return GaussianIncrement.from_std(np.array([x, y, theta]), std)


def _chord(angle: float) -> tuple[complex, complex]:
    """End of the unit-length arc that turns by `angle`, (sin a + i (1 - cos a)) / a, and its derivative."""
    if abs(angle) < 1e-5:  # where the quotients cancel, two terms of the series are exact to 1e-10
        return complex(1.0, angle / 2), complex(-angle / 3, 0.5)
    tip = cmath.exp(1j * angle)
    chord = (tip - 1) / (1j * angle)
    return chord, (tip - chord) / angle


@final
@checked
@parameters(frozen=True)
class VelocityMotion:
    """Velocity motion model: the robot drives an arc at noisy v and omega, and turns at its end by a noisy gamma dt.

    Without turn rate the arc is a straight line; no value of omega divides by zero.

    Parameters
    ----------
    alpha1 : float, (m/s)^2/(m/s)^2, >= 0
        Variance of v per squared v.
    alpha2 : float, (m/s)^2/(rad/s)^2, >= 0
        Variance of v per squared omega.
    alpha3 : float, (rad/s)^2/(m/s)^2, >= 0
        Variance of omega per squared v.
    alpha4 : float, (rad/s)^2/(rad/s)^2, >= 0
        Variance of omega per squared omega.
    alpha5, alpha6 : float, >= 0
        Variance of the final turn rate gamma per squared v and per squared omega, units as alpha3 and alpha4. Without
        it the three-dimensional pose would lie on a two-dimensional surface.

    Notes
    -----
    The defaults are wide (a tenth of the speed) for the drive; gamma only has to fill the third dimension.

    References
    ----------
    Probabilistic Robotics, Table 5.3 (`sample_motion_model_velocity`).
    """

    alpha1: float = bounded(0.01, ge=0, le=100)
    alpha2: float = bounded(0.01, ge=0, le=100)
    alpha3: float = bounded(0.01, ge=0, le=100)
    alpha4: float = bounded(0.01, ge=0, le=100)
    alpha5: float = bounded(0.001, ge=0, le=100)
    alpha6: float = bounded(0.001, ge=0, le=100)

    def __call__(self, control: Annotated[FloatArray, 3]) -> GaussianIncrement:
        """Condition on a control (3,) [v m/s, omega rad/s, dt s].

        Raises
        ------
        ArgumentError
            Unless it is three finite numbers with dt >= 0.
        """
        v, omega, dt = _finite_triple(control, "control")
        if dt < 0:
            raise ArgumentError("control", "a duration dt >= 0 s", dt)
        variance = [
            self.alpha1 * v**2 + self.alpha2 * omega**2,
            self.alpha3 * v**2 + self.alpha4 * omega**2,
            self.alpha5 * v**2 + self.alpha6 * omega**2,
        ]
        chord, chord_by_angle = _chord(omega * dt)
        by_omega = v * dt**2 * chord_by_angle
        jacobian = [[chord.real * dt, by_omega.real, 0.0], [chord.imag * dt, by_omega.imag, 0.0], [0.0, dt, dt]]

        def to_increment(values: FloatArray) -> FloatArray:
            speed, rate, gamma = values.T
            increments = exp(np.stack([speed * dt, np.zeros_like(speed), rate * dt], axis=-1))
            increments[:, 2] += gamma * dt
            return increments

        increment = np.array([v * dt * chord.real, v * dt * chord.imag, math.remainder(omega * dt, math.tau)])
        mean = np.array([v, omega, 0.0])
        return GaussianIncrement(mean, np.sqrt(variance), increment, np.array(jacobian), to_increment)
