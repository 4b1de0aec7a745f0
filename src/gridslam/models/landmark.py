"""Measurement models of point landmarks: what the robot sees of one, with Jacobians, and where one is that it sees.

A pose is (..., 3) [x m, y m, theta rad] and a landmark (..., 2) [x m, y m], both in the map frame; the leading
dimensions of the two broadcast, so one call serves all particles and all landmarks.
"""

from __future__ import annotations

from typing import Protocol, final, runtime_checkable

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import transform_points
from gridslam.models.parameters import STRICT
from gridslam.models.sightings import Sightings
from gridslam.types import FloatArray

__all__ = ["DepthBearing", "LandmarkModel", "RangeBearing", "RelativePosition"]


@runtime_checkable
class LandmarkModel(Protocol):
    """p(z | x, m) = N(z; h(x, m), Q) for one landmark m."""

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """h (..., 2) and its Jacobians by the pose, (..., 2, 3), and by the landmark, (..., 2, 2)."""

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Difference (..., 2) of two measurements, angles in [-pi, pi)."""

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Where the landmark (..., 2) is that is measured so: h^-1(x, z)."""

    def noise(self, sightings: Sightings) -> FloatArray:
        """Q (K, 2, 2) of K sightings: their own covariances where they have any, else the model's."""


@final
@parameters(frozen=True, config=STRICT)
class RangeBearing:
    """Range and bearing to a landmark, each with Gaussian noise.

    Parameters
    ----------
    sigma_range_m : float, m, > 0
        A monocular camera that measures a barcode's height at some metres errs by one or two tenths.
    sigma_bearing_rad : float, rad, > 0
        1 degree: some pixels of a camera, with the pose's jitter between picture and odometry.

    Source: Probabilistic Robotics, equations 6.40 and 7.14 (without the signature), and 10.23.
    """

    sigma_range_m: float = Field(default=0.15, gt=0)
    sigma_bearing_rad: float = Field(default=0.02, gt=0)

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """[range m, bearing rad] and its Jacobians; a landmark must not lie where the robot is."""
        dx, dy = landmarks[..., 0] - poses[..., 0], landmarks[..., 1] - poses[..., 1]
        distance = np.sqrt(dx * dx + dy * dy)
        predicted, by_pose, by_landmark = _bearing(dx, dy, poses[..., 2])
        predicted[..., 0] = distance
        by_landmark[..., 0, 0], by_landmark[..., 0, 1] = dx / distance, dy / distance
        by_pose[..., 0, :2] = -by_landmark[..., 0, :]
        return predicted, by_pose, by_landmark

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Measured minus predicted, the bearing's in [-pi, pi)."""
        return _with_bearing_wrapped(measured - predicted)

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the point (..., 2) in this distance and direction from the pose."""
        direction = poses[..., 2] + measured[..., 1]
        offset = measured[..., :1] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        return np.asarray(poses[..., :2] + offset)

    def noise(self, sightings: Sightings) -> FloatArray:
        """Q (K, 2, 2) [m^2, m rad, rad^2] of K sightings."""
        return _noise(sightings, self.sigma_range_m, self.sigma_bearing_rad)


@final
@parameters(frozen=True, config=STRICT)
class DepthBearing:
    """Depth and bearing to a landmark, as a camera measures them: the depth is taken along the optical axis.

    A camera that tells how far a mark is from how large it looks tells its depth, d = r cos(bearing), also where it is
    called a range. It does in MRCLAM: there the ratio of what is called range to the true range falls from 1.02 ahead
    to 0.90 at 31 degrees, as the cosine does, and what is called range errs by 0.12 to 0.17 m, as depth by 0.04 m.

    Parameters
    ----------
    sigma_depth_m : float, m, > 0
        0.04 m is the noise of MRCLAM's cameras; the rest is for what their mounting leaves.
    sigma_bearing_rad : float, rad, > 0
        0.01 rad of noise, some pixels, and the pose's jitter between picture and odometry.
    """

    sigma_depth_m: float = Field(default=0.05, gt=0)
    sigma_bearing_rad: float = Field(default=0.015, gt=0)

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """[depth m, bearing rad] and its Jacobians; a landmark must not lie where the robot is."""
        dx, dy = landmarks[..., 0] - poses[..., 0], landmarks[..., 1] - poses[..., 1]
        c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        predicted, by_pose, by_landmark = _bearing(dx, dy, poses[..., 2])
        predicted[..., 0] = c * dx + s * dy
        by_landmark[..., 0, 0], by_landmark[..., 0, 1] = c, s
        by_pose[..., 0, 0], by_pose[..., 0, 1], by_pose[..., 0, 2] = -c, -s, c * dy - s * dx
        return predicted, by_pose, by_landmark

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Measured minus predicted, the bearing's in [-pi, pi)."""
        return _with_bearing_wrapped(measured - predicted)

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the point (..., 2) at this depth in this direction."""
        across = measured[..., 0] * np.tan(measured[..., 1])
        return transform_points(poses, np.stack([measured[..., 0], across], axis=-1))

    def noise(self, sightings: Sightings) -> FloatArray:
        """Q (K, 2, 2) [m^2, m rad, rad^2] of K sightings."""
        return _noise(sightings, self.sigma_depth_m, self.sigma_bearing_rad)


@final
@parameters(frozen=True, config=STRICT)
class RelativePosition:
    """Position of a landmark in the robot's frame (x forward, y left), each coordinate with Gaussian noise.

    Linear in the landmark, and in the robot's position: only its heading makes it nonlinear.

    Parameters
    ----------
    sigma_x_m, sigma_y_m : float, m, > 0
        0.6 m is what the Victoria Park file says of tree trunks seen by a laser from up to 20 m.
    """

    sigma_x_m: float = Field(default=0.6, gt=0)
    sigma_y_m: float = Field(default=0.6, gt=0)

    def linearize(self, poses: FloatArray, landmarks: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """[x m, y m] in the robot's frame and its Jacobians."""
        dx, dy = landmarks[..., 0] - poses[..., 0], landmarks[..., 1] - poses[..., 1]
        c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
        x, y = c * dx + s * dy, c * dy - s * dx
        by_landmark = np.empty((*x.shape, 2, 2))
        by_landmark[..., 0, 0] = by_landmark[..., 1, 1] = c
        by_landmark[..., 0, 1], by_landmark[..., 1, 0] = s, -s
        by_pose = np.empty((*x.shape, 2, 3))
        by_pose[..., :2] = -by_landmark
        by_pose[..., 0, 2], by_pose[..., 1, 2] = y, -x
        return np.stack([x, y], axis=-1), by_pose, by_landmark

    def residual(self, measured: FloatArray, predicted: FloatArray) -> FloatArray:
        """Measured minus predicted."""
        return measured - predicted

    def locate(self, poses: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the point (..., 2) that lies there in the robot's frame."""
        return transform_points(poses, measured)

    def noise(self, sightings: Sightings) -> FloatArray:
        """Q (K, 2, 2) [m^2] of K sightings."""
        return _noise(sightings, self.sigma_x_m, self.sigma_y_m)


def _bearing(dx: FloatArray, dy: FloatArray, heading: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measurement (..., 2) and its Jacobians, of which the second row, the bearing's, is filled in."""
    square = dx * dx + dy * dy
    predicted, by_pose, by_landmark = (np.zeros((*square.shape, *shape)) for shape in ((2,), (2, 3), (2, 2)))
    predicted[..., 1] = wrap(np.arctan2(dy, dx) - heading)
    by_landmark[..., 1, 0], by_landmark[..., 1, 1] = -dy / square, dx / square
    by_pose[..., 1, :2], by_pose[..., 1, 2] = -by_landmark[..., 1, :], -1.0
    return predicted, by_pose, by_landmark


def _with_bearing_wrapped(residual: FloatArray) -> FloatArray:
    residual[..., 1] = wrap(residual[..., 1])
    return residual


def _noise(sightings: Sightings, first: float, second: float) -> FloatArray:
    if sightings.covariances is not None:
        return sightings.covariances
    return np.broadcast_to(np.diag([first**2, second**2]), (len(sightings), 2, 2))

