"""SE(3) as homogeneous matrices (4, 4)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from gridslam.geometry import rigid
from gridslam.geometry.angles import wrap


def from_quaternion(translation: ArrayLike, xyzw: ArrayLike) -> np.ndarray:
    return rigid.to_matrix(rigid.from_quaternion(np.asarray(translation).tolist(), np.asarray(xyzw).tolist()))


def from_planar(pose: ArrayLike) -> np.ndarray:
    return rigid.matrix_of_planar(np.asarray(pose, np.float64))


def to_planar(transform: np.ndarray) -> np.ndarray:
    x, y, yaw = rigid.planar(rigid.from_matrix(transform))
    return np.array((x, y, wrap(yaw)))


def tilt_rad(transform: np.ndarray) -> float:
    """Angle between the z axes: 0 where it is level, pi where it is upside down."""
    return math.atan2(math.hypot(*transform[:2, 2]), transform[2, 2])
