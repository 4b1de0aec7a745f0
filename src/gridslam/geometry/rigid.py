"""SE(3) in seven Python floats: a translation and a unit quaternion, [x m, y m, z m, qx, qy, qz, qw].

What a transform buffer computes with, one motion at a time: several times faster than arrays of one element. The rest
of the package knows homogeneous matrices (4, 4). q and -q are the same rotation. Frames are right-handed with x ahead,
y to the left and z up.

Source: Sola, Quaternion kinematics for the error-state Kalman filter (2017), chapters 1 and 2; Shoemake, Animating
rotation with quaternion curves (1985).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError

Rigid: TypeAlias = tuple[float, float, float, float, float, float, float]

_ROTATION_TOLERANCE = 1e-6
_NORM_TOLERANCE = 0.01  # of the squared norm; what ROS's tf2 takes, and so what stands in logs
_FARTHEST_M = 1e9  # no frame on Earth is farther from another: such a number is an error


@checked
def from_quaternion(translation: Sequence[float], xyzw: Sequence[float]) -> Rigid:
    """Return motion of a translation (3,) in m and a quaternion (4,), which is brought to unit norm.

    Raises ArgumentError for a value that is not finite, a translation of 1e9 m or more, and a squared norm farther than
    0.01 from 1: a quaternion of zeros, which stands in many a log, is no rotation.
    """
    x, y, z = translation
    i, j, k, w = xyzw
    square = i * i + j * j + k * k + w * w
    if not abs(square - 1.0) <= _NORM_TOLERANCE:
        raise ArgumentError("xyzw", "a quaternion of norm 1", f"{[i, j, k, w]}, of norm {math.sqrt(square):.6g}")
    if not abs(x) + abs(y) + abs(z) < _FARTHEST_M:
        raise ArgumentError("translation", f"x, y, z of less than {_FARTHEST_M:g} m", [x, y, z])
    scale = 1.0 / math.sqrt(square)
    return x, y, z, scale * i, scale * j, scale * k, scale * w


@checked
def from_matrix(matrix: ArrayLike) -> Rigid:
    """Return motion of a homogeneous matrix (4, 4).

    Raises ArgumentError if its shape is another, a value is not finite, its last row is not (0, 0, 0, 1) or the upper
    left block is no rotation (to 1e-6).

    Source: Shepperd, Quaternion from rotation matrix (1978).
    """
    given = np.asarray(matrix, dtype=np.float64)
    if given.shape != (4, 4):
        raise ArgumentError("matrix", "shape (4, 4)", given.shape)
    (a, b, c, x), (d, e, f, y), (g, h, i, z), last = given.tolist()
    # The third row of a rotation is the cross product of the first two, which are of length 1 and orthogonal.
    worst = max(
        abs(a * a + b * b + c * c - 1),
        abs(d * d + e * e + f * f - 1),
        abs(a * d + b * e + c * f),
        abs(b * f - c * e - g),
        abs(c * d - a * f - h),
        abs(a * e - b * d - i),
    )
    if not worst <= _ROTATION_TOLERANCE or last != [0, 0, 0, 1] or not math.isfinite(x + y + z + worst):
        raise ArgumentError("matrix", "a rotation, a finite translation and a last row (0, 0, 0, 1)", given.tolist())
    trace = a + e + i
    if trace >= max(a, e, i):  # the greatest of the four is divided by: no cancellation
        q = h - f, c - g, d - b, 1 + trace
    elif a >= max(e, i):
        q = 1 + 2 * a - trace, b + d, c + g, h - f
    elif e >= i:
        q = b + d, 1 + 2 * e - trace, f + h, c - g
    else:
        q = c + g, f + h, 1 + 2 * i - trace, d - b
    scale = 1.0 / math.hypot(*q)
    return x, y, z, scale * q[0], scale * q[1], scale * q[2], scale * q[3]


@checked
def to_matrix(a: Rigid) -> NDArray[np.float64]:
    """Homogeneous matrix (4, 4) of a motion."""
    x, y, z, i, j, k, w = a
    return np.array(
        (
            (1 - 2 * (j * j + k * k), 2 * (i * j - w * k), 2 * (i * k + w * j), x),
            (2 * (i * j + w * k), 1 - 2 * (i * i + k * k), 2 * (j * k - w * i), y),
            (2 * (i * k - w * j), 2 * (j * k + w * i), 1 - 2 * (i * i + j * j), z),
            (0.0, 0.0, 0.0, 1.0),
        )
    )


@checked
def matrix_of_planar(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Homogeneous matrix (4, 4) of a pose (3,) = [x m, y m, theta rad] in the ground plane."""
    x, y, theta = pose.tolist()
    c = math.cos(theta)
    s = math.sin(theta)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


@checked
def planar(a: Rigid) -> tuple[float, float, float]:
    """Return pose (x m, y m, yaw rad) seen from above: yaw in [-pi, pi] is the direction of the projected x axis.

    Raises ArgumentError where the x axis is vertical (to 1e-6) and so points nowhere on the ground.
    """
    x, y, _, i, j, k, w = a
    ahead = 1 - 2 * (j * j + k * k)
    left = 2 * (i * j + w * k)
    if abs(ahead) + abs(left) < _ROTATION_TOLERANCE:
        raise ArgumentError("transform", "an x axis that is not vertical, to be seen from above", a)
    return x, y, math.atan2(left, ahead)


@checked
def compose(a: Rigid, b: Rigid) -> Rigid:
    """Compose motions: with frames in the names, `compose(map_from_robot, robot_from_laser)` is `map_from_laser`."""
    ax, ay, az, ai, aj, ak, aw = a
    bx, by, bz, bi, bj, bk, bw = b
    # A vector v turned by (u, w) is v + w c + u x c with c = 2 u x v.
    cx = 2 * (aj * bz - ak * by)
    cy = 2 * (ak * bx - ai * bz)
    cz = 2 * (ai * by - aj * bx)
    return (
        ax + bx + aw * cx + aj * cz - ak * cy,
        ay + by + aw * cy + ak * cx - ai * cz,
        az + bz + aw * cz + ai * cy - aj * cx,
        aw * bi + ai * bw + aj * bk - ak * bj,
        aw * bj + aj * bw + ak * bi - ai * bk,
        aw * bk + ak * bw + ai * bj - aj * bi,
        aw * bw - ai * bi - aj * bj - ak * bk,
    )


@checked
def inverse(a: Rigid) -> Rigid:
    """Invert a motion: compose(a, inverse(a)) is the identity."""
    x, y, z, i, j, k, w = a
    back = (0.0, 0.0, 0.0, -i, -j, -k, w)
    return (*compose(back, (-x, -y, -z, 0.0, 0.0, 0.0, 1.0))[:3], -i, -j, -k, w)


@checked
def interpolate(a: Rigid, b: Rigid, fraction: float) -> Rigid:
    """Motion at `fraction` in [0, 1] of the way from `a` to `b`: a straight line and the shorter arc, both uniform.

    Between rotations half a turn apart both arcs are equally short, and either may be taken.

    Source: Shoemake (1985), section 3.3.
    """
    ax, ay, az, ai, aj, ak, aw = a
    bx, by, bz, bi, bj, bk, bw = b
    cosine = ai * bi + aj * bj + ak * bk + aw * bw
    p = s = 1.0 - fraction
    q = t = fraction
    if abs(cosine) < 1.0:
        angle = math.acos(abs(cosine))
        scale = 1.0 / math.sin(angle)
        s = scale * math.sin(p * angle)
        t = scale * math.sin(q * angle)
    if cosine < 0.0:
        t = -t
    return (
        p * ax + q * bx,
        p * ay + q * by,
        p * az + q * bz,
        s * ai + t * bi,
        s * aj + t * bj,
        s * ak + t * bk,
        s * aw + t * bw,
    )
