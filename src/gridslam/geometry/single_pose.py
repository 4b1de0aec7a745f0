"""SE(2) on one pose at a time: the functions of `gridslam.geometry.se2` on tuples of three Python floats.

What a tracker computes at every scan is one pose, for which arrays cost ten times the arithmetic. Poses are
(x m, y m, theta rad), and what the functions return has theta in [-pi, pi).
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.angles import wrap

Pose: TypeAlias = tuple[float, float, float]
"""One pose (x m, y m, theta rad), or a twist, or the increment between two poses."""

Information: TypeAlias = tuple[float, float, float, float, float, float]
"""Information of one pose, a symmetric matrix by its upper triangle: (xx, xy, xt, yy, yt, tt) over m and rad."""

ORIGIN: Pose = (0.0, 0.0, 0.0)

UNKNOWN_POSE: Pose = (math.nan, math.nan, math.nan)
"""Stands for a pose that is unknown."""


def as_pose(values: NDArray[np.float64]) -> Pose:
    """Return the pose in an array (3,)."""
    x, y, theta = values.tolist()
    return x, y, theta


def is_known(pose: Pose) -> bool:
    """Return whether a pose is another than `UNKNOWN_POSE`."""
    return not math.isnan(pose[0])


def compose(a: Pose, b: Pose) -> Pose:
    """Compose two poses: where `b`, given in the frame of `a`, lies in the frame in which `a` is given."""
    ax, ay, at = a
    bx, by, bt = b
    c = math.cos(at)
    s = math.sin(at)
    return ax + c * bx - s * by, ay + s * bx + c * by, wrap(at + bt)


def between(a: Pose, b: Pose) -> Pose:
    """Return pose of `b` seen from `a`, that is inverse(a) compose b, for poses given in one frame."""
    ax, ay, at = a
    bx, by, bt = b
    c = math.cos(at)
    s = math.sin(at)
    dx = bx - ax
    dy = by - ay
    return c * dx + s * dy, c * dy - s * dx, wrap(bt - at)


def exp(xi: Pose) -> Pose:
    """Return pose reached by moving with the constant twist `xi` for one unit of time.

    Source: Sola et al., A micro Lie theory (2018), equations 156 and 158.
    """
    vx, vy, omega = xi
    half = 0.5 * omega
    c = math.cos(half)
    s = math.sin(half)
    chord = s / half if half else 1.0
    return chord * (c * vx - s * vy), chord * (s * vx + c * vy), wrap(omega)


def log(pose: Pose) -> Pose:
    """Return twist whose `exp` is `pose`, the one with omega in [-pi, pi).

    Source: Sola et al., A micro Lie theory (2018), equation 157.
    """
    x, y, theta = pose
    omega = wrap(theta)
    half = 0.5 * omega
    c = math.cos(half)
    s = math.sin(half)
    chord = s / half if half else 1.0
    return (c * x + s * y) / chord, (c * y - s * x) / chord, omega


def motion_of(increment: Pose) -> tuple[float, float]:
    """Return metres and radians of an increment, both >= 0."""
    x, y, turn = increment
    return math.hypot(x, y), abs(turn)


def is_within(a: Pose, b: Pose, metres: float, radians: float) -> bool:
    """Return whether two poses differ by less than both limits."""
    near = math.hypot(a[0] - b[0], a[1] - b[1]) < metres
    return near and abs(math.remainder(a[2] - b[2], math.tau)) < radians
