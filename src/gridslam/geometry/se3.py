"""SE(3), the rigid motions of space, as homogeneous matrices (4, 4), and their projection to the plane.

With frames in the names, `map_from_robot @ robot_from_laser` is `map_from_laser`. Frames are right-handed with x ahead,
y to the left and z up; quaternions are [x, y, z, w] as in ROS.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry import rigid
from gridslam.geometry.angles import wrap

FloatArray = NDArray[np.float64]


@checked
def from_quaternion(translation: ArrayLike, xyzw: ArrayLike) -> FloatArray:
    """Build a transform from a translation and a quaternion.

    Parameters
    ----------
    translation : (3,) float64, m
        Finite.
    xyzw : (4,) float64
        Of norm 1; one whose squared norm is within 0.01 of 1, as single precision leaves it, is brought to norm 1.

    Returns
    -------
    (4, 4) float64

    Raises
    ------
    ArgumentError
        For other shapes, values that are not finite, and a quaternion that is no rotation, such as all zeros.
    """
    return rigid.to_matrix(rigid.from_quaternion(_vector(translation, "translation", 3), _vector(xyzw, "xyzw", 4)))


@checked
def to_quaternion(transform: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Translation (3,) in m and unit quaternion xyzw (4,) of a transform (4, 4); of q and -q the one with w >= 0.

    Raises ArgumentError where `transform` is not rigid.
    """
    values = np.array(rigid.from_matrix(transform))
    return values[:3], math.copysign(1.0, values[6]) * values[3:]


@checked
def from_planar(pose: ArrayLike) -> FloatArray:
    """Transform (4, 4) of a pose (3,) = [x m, y m, theta rad] in the ground plane; raises ArgumentError otherwise."""
    x, y, theta = _vector(pose, "pose", 3)
    c = math.cos(theta)
    s = math.sin(theta)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@checked
def to_planar(transform: ArrayLike) -> FloatArray:
    """Return pose (3,) = [x m, y m, yaw rad] of a transform (4, 4) seen from above.

    Yaw in [-pi, pi) is the direction of the x axis projected on the ground plane: for a laser mounted upside down,
    the way it looks. Raises ArgumentError where the transform is not rigid or its x axis is vertical.
    """
    x, y, yaw = rigid.planar(rigid.from_matrix(transform))
    return np.array((x, y, wrap(yaw)))


@checked
def tilt_rad(transform: ArrayLike) -> float:
    """Angle in [0, pi] between the z axes of a transform (4, 4): 0 where it is level, pi where it is upside down.

    Raises ArgumentError where the transform is not rigid.
    """
    rigid.from_matrix(transform)  # raises where it is not rigid
    axis = np.asarray(transform, dtype=np.float64)[:3, 2]
    return math.atan2(math.hypot(axis[0], axis[1]), axis[2])


def _vector(values: ArrayLike, name: str, width: int) -> list[float]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (width,) or not np.isfinite(array).all():
        raise ArgumentError(name, f"{width} finite numbers", array.tolist())
    floats: list[float] = array.tolist()
    return floats
