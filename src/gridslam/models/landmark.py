"""Landmark observations, and measurement models of point landmarks with their inverses.

A pose is (..., 3) [x m, y m, theta rad] and a landmark (..., 2) [x m, y m], both in the map frame; the leading
dimensions of the two broadcast, so one call serves all particles and all landmarks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol, TypeAlias, final, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import freeze
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import transform_points
from gridslam.models.motion import GaussianIncrement
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, IntArray, MotionModel, MotionSampler


class ObservationKind(Enum):
    """Type of the two numbers of an observation."""

    RANGE_BEARING = "range (m) and bearing (rad)"
    DEPTH_BEARING = "depth along the optical axis (m) and bearing (rad)"
    POSITION = "x and y in the robot's frame (m)"


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkObservations:
    """Landmark observations at one time: z_t, and c_t if known.

    Attributes
    ----------
    values : (K, 2) float64
        Measurements, of the type given by `ObservationKind`, in the robot's frame.
    landmarks : (K,) int64 or None
        The signature of each, by which it is known again; None where nothing is known. No two are the same.
    covariances : (K, 2, 2) float64 or None
        Covariance of each measurement, if the log contains them; they take precedence over the measurement model's.
    """

    values: FloatArray
    landmarks: IntArray | None = None
    covariances: FloatArray | None = None

    @classmethod
    def of(
        cls, values: ArrayLike, landmarks: ArrayLike | None = None, covariances: ArrayLike | None = None
    ) -> LandmarkObservations:
        """Validate and copy; raises ArgumentError for a wrong shape, a value that is not finite, a landmark twice."""
        z = freeze(values, np.float64, (None, 2), "values")
        count = len(z)
        names = None if landmarks is None else freeze(landmarks, np.int64, (count,), "landmarks")
        spread = None if covariances is None else freeze(covariances, np.float64, (count, 2, 2), "covariances")
        if not np.isfinite(z).all() or (spread is not None and not np.isfinite(spread).all()):
            raise ArgumentError("observations", "finite numbers", "a value that is not")
        if names is not None and len(np.unique(names)) < count:
            raise ArgumentError("landmarks", "each landmark once at a time", names.tolist())
        return cls(z, names, spread)

    def __len__(self) -> int:
        """Return the number K of observations."""
        return len(self.values)

    def drop_correspondences(self) -> LandmarkObservations:
        """Return the same observations without correspondences."""
        return replace(self, landmarks=None)


NO_OBSERVATIONS = LandmarkObservations.of(np.empty((0, 2)), np.empty(0, np.int64))
"""The observations of a step at which no landmark was observed."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkStep:
    """One step of a log: u_t and z_t.

    Attributes
    ----------
    stamp_ns : int
        Of the observations, or of the end of the motion without observations.
    increment : (3,) float64
        The robot now, seen from where it was at the step before, by its odometry [x m, y m, theta rad].
    covariance : (3, 3) float64 or None
        Of the increment, in the frame of the last pose, if the log contains it; None leaves it to the motion model.
    observations : LandmarkObservations
        Landmarks seen now; perhaps none.
    """

    stamp_ns: int
    increment: FloatArray
    covariance: FloatArray | None
    observations: LandmarkObservations

    def motion(self, model: MotionModel) -> MotionSampler:
        """p(x_t | u_t, x_{t-1}): with the increment's own covariance if the log contains one, else by the model."""
        if self.covariance is None:
            return model(self.increment)
        return GaussianIncrement.with_covariance(self.increment, self.covariance)


_Row: TypeAlias = Sequence[FloatArray | float]


@runtime_checkable
class LandmarkModel(Protocol):
    """p(z | x, m) = N(z; h(x, m), Q) for one landmark m."""

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """h (..., 2) and its Jacobians by the pose, (..., 2, 3), and by the landmark, (..., 2, 2)."""
        ...

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Return difference (..., 2) of two measurements, angles in [-pi, pi)."""
        ...

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Return where the landmark (..., 2) is that is measured so: h^-1(x, z)."""
        ...

    def noise(self, observations: LandmarkObservations) -> FloatArray:
        """Q (K, 2, 2) of K observations: their own covariances if they have any, else the model's."""
        ...


@final
@parameters(frozen=True)
class RangeBearing:
    """Range and bearing to a landmark, each with Gaussian noise.

    Parameters
    ----------
    sigma_range_m : float, m, > 0
        A monocular camera that measures a barcode's height at some metres errs by one or two tenths.
    sigma_bearing_rad : float, rad, > 0
        1 degree: some pixels of a camera, with the pose's jitter between picture and odometry.

    References
    ----------
    Probabilistic Robotics, equations 6.40 and 7.14 (without the signature), and 10.23.
    """

    sigma_range_m: float = bounded(0.15, gt=0)
    sigma_bearing_rad: float = bounded(0.02, gt=0)

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """[range m, bearing rad] and its Jacobians; a landmark must not lie where the robot is."""
        dx, dy = offset(poses, landmarks)
        distance = np.sqrt(dx * dx + dy * dy)
        cos = dx / distance
        sin = dy / distance
        by_pose, by_landmark = _with_bearing(dx, dy, [-cos, -sin, 0.0], [cos, sin])
        return np.stack([distance, _bearing(dx, dy, poses)], axis=-1), by_pose, by_landmark

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Measured minus predicted, the bearing's in [-pi, pi)."""
        return _with_bearing_wrapped(measured - predicted)

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the point (..., 2) in this distance and direction from the pose."""
        direction = poses[..., 2] + measured[..., 1]
        ahead = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        return np.asarray(poses[..., :2] + measured[..., :1] * ahead)

    def noise(self, observations: LandmarkObservations) -> FloatArray:
        """Q (K, 2, 2) [m^2, m rad, rad^2] of K observations."""
        return _noise(observations, self.sigma_range_m**2, self.sigma_bearing_rad**2)


@final
@parameters(frozen=True)
class DepthBearing:
    """Depth and bearing to a landmark, as a camera measures them: the depth is taken along the optical axis.

    A camera that estimates the distance of a mark from its size measures its depth, d = r cos(bearing), also where it
    is called a range. It does in MRCLAM: there the ratio of what is called range to the true range falls from 1.02
    ahead to 0.90 at 31 degrees, as the cosine does, and what is called range errs by 0.12 to 0.17 m, as depth by
    0.04 m.

    Parameters
    ----------
    sigma_depth_m : float, m, > 0
        What does not grow with the depth, such as the mounting of the camera.
    sigma_depth_per_m : float, 1/m, >= 0
        Times the square of the depth: a mark at depth d is f H / d pixels high, so a pixel of its height is d^2 / (f H)
        of depth. The depths in MRCLAM's files are 0.0035 d^2 apart, as 7.05, 7.23 and 7.43 m.
    sigma_bearing_rad : float, rad, > 0
        Some pixels. Both sigmas are twice what MRCLAM's cameras have against the truth: in one pass a robot sees a mark
        from about one side, so errors of successive observations are alike, and the filters take them as independent.
    """

    sigma_depth_m: float = bounded(0.1, gt=0)
    sigma_depth_per_m: float = bounded(0.002, ge=0)
    sigma_bearing_rad: float = bounded(0.02, gt=0)

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """[depth m, bearing rad] and its Jacobians; a landmark must not lie where the robot is."""
        dx, dy = offset(poses, landmarks)
        c = np.cos(poses[..., 2])
        s = np.sin(poses[..., 2])
        by_pose, by_landmark = _with_bearing(dx, dy, [-c, -s, c * dy - s * dx], [c, s])
        return np.stack([c * dx + s * dy, _bearing(dx, dy, poses)], axis=-1), by_pose, by_landmark

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Measured minus predicted, the bearing's in [-pi, pi)."""
        return _with_bearing_wrapped(measured - predicted)

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the point (..., 2) at this depth in this direction."""
        across = measured[..., 0] * np.tan(measured[..., 1])
        return transform_points(poses, np.stack([measured[..., 0], across], axis=-1))

    def noise(self, observations: LandmarkObservations) -> FloatArray:
        """Q (K, 2, 2) [m^2, m rad, rad^2] of K observations."""
        by_depth = self.sigma_depth_per_m * observations.values[:, 0] ** 2
        return _noise(observations, self.sigma_depth_m**2 + by_depth**2, self.sigma_bearing_rad**2)


@final
@parameters(frozen=True)
class RelativePosition:
    """Position of a landmark in the robot's frame (x forward, y left), each coordinate with Gaussian noise.

    Linear in the landmark, and in the robot's position: only its heading makes it nonlinear.

    Parameters
    ----------
    sigma_x_m, sigma_y_m : float, m, > 0
        0.6 m is the value of the Victoria Park file for tree trunks seen by a laser from up to 20 m.
    """

    sigma_x_m: float = bounded(0.6, gt=0)
    sigma_y_m: float = bounded(0.6, gt=0)

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """[x m, y m] in the robot's frame and its Jacobians."""
        dx, dy = offset(poses, landmarks)
        c = np.cos(poses[..., 2])
        s = np.sin(poses[..., 2])
        x = c * dx + s * dy
        y = c * dy - s * dx
        by_pose = _matrices(x.shape, [-c, -s, y], [s, -c, -x])
        return np.stack([x, y], axis=-1), by_pose, _matrices(x.shape, [c, s], [-s, c])

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Measured minus predicted."""
        return measured - predicted

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the point (..., 2) in the robot's frame."""
        return transform_points(poses, measured)

    def noise(self, observations: LandmarkObservations) -> FloatArray:
        """Q (K, 2, 2) [m^2] of K observations."""
        return _noise(observations, self.sigma_x_m**2, self.sigma_y_m**2)


def offset(poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray]:
    """x and y (...) of landmarks (..., 2) as seen from poses (..., 3), along the axes of the map."""
    return landmarks[..., 0] - poses[..., 0], landmarks[..., 1] - poses[..., 1]


def _bearing(dx: FloatArray, dy: FloatArray, poses: FloatArray) -> FloatArray:
    """Bearing (...), in [-pi, pi), of a landmark at (dx, dy) from a pose."""
    return wrap(np.arctan2(dy, dx) - poses[..., 2])


def _with_bearing(dx: FloatArray, dy: FloatArray, by_pose: _Row, by_landmark: _Row) -> tuple[FloatArray, FloatArray]:
    """Return Jacobians of two numbers of which the second is the bearing, from the rows of the first."""
    square = dx * dx + dy * dy
    x = dx / square
    y = dy / square
    return _matrices(dx.shape, by_pose, [y, -x, -1.0]), _matrices(dx.shape, by_landmark, [-y, x])


def _matrices(shape: tuple[int, ...], *rows: _Row) -> FloatArray:
    """Matrices (*shape, I, J) of I rows of J entries each, which broadcast to `shape`."""
    matrices = np.empty((*shape, len(rows), len(rows[0])))
    for i, row in enumerate(rows):
        for j, number in enumerate(row):
            matrices[..., i, j] = number
    return matrices


def _with_bearing_wrapped(residual: FloatArray) -> FloatArray:
    residual[..., 1] = wrap(residual[..., 1])
    return residual


def _noise(observations: LandmarkObservations, first: float | FloatArray, second: float) -> FloatArray:
    """Covariances (K, 2, 2) of the observations: their own if there are any, else of these variances."""
    if observations.covariances is not None:
        return observations.covariances
    noise = np.zeros((len(observations), 2, 2))
    noise[:, 0, 0] = first
    noise[:, 1, 1] = second
    return noise
