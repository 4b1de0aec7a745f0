"""SE(2), the rigid motions of the plane, on arrays of poses [x m, y m, theta rad].

With frames in the names, `compose(map_from_robot, robot_from_laser)` is `map_from_laser`. All functions broadcast
over the leading dimensions, and what they return has theta in [-pi, pi). Jacobians of `compose` and `between` are
partial derivatives of the coordinates [x, y, theta], and covariances are by x and y in m and theta in rad (Smith, Self
and Cheeseman 1990); `adjoint` belongs to the tangent space, of vectors [v_x, v_y, omega] (Sola, Deray and Atchuthan
2018).

A single pose takes the same formulas through Python floats, which is several times faster than arrays of one element.
"""

from __future__ import annotations

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap

FloatArray = NDArray[np.float64]
_MANY = 100  # angles, for which small products of matrices take longer than sums along them
_FLOAT64 = np.dtype(np.float64)  # NumPy's one and only, so that it need not be compared
Component: TypeAlias = Any  # a float for a single pose, else an array over the leading dimensions


@checked
def compose(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Compose poses: where `b`, given in the frame of `a`, lies in the frame in which `a` is given.

    Parameters
    ----------
    a, b : (..., 3) float64
        Poses [m, m, rad]; leading dimensions broadcast.

    Returns
    -------
    (..., 3) float64
        `a` compose `b`.

    Raises
    ------
    ArgumentError
        If the last dimension of an argument is not 3.
    """
    ax, ay, at = _components(a, "a")
    bx, by, bt = _components(b, "b")
    c, s = _cos_sin(at)
    return _pose(ax + c * bx - s * by, ay + s * bx + c * by, at + bt)


@checked
def between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return pose of `b` seen from `a`, that is inverse(a) compose b, for poses (..., 3) given in one frame.

    Raises ArgumentError if the last dimension of an argument is not 3.
    """
    ax, ay, at = _components(a, "a")
    bx, by, bt = _components(b, "b")
    c, s = _cos_sin(at)
    dx = bx - ax
    dy = by - ay
    return _pose(c * dx + s * dy, c * dy - s * dx, bt - at)


@checked
def inverse(a: ArrayLike) -> FloatArray:
    """Invert poses (..., 3): compose(a, inverse(a)) is the identity.

    Raises ArgumentError if the last dimension of `a` is not 3.
    """
    x, y, theta = _components(a, "a")
    c, s = _cos_sin(theta)
    return _pose(-c * x - s * y, s * x - c * y, -theta)


@checked
def exp(xi: ArrayLike) -> FloatArray:
    """Return pose (..., 3) reached by moving with the constant twist `xi` for one unit of time.

    The robot drives an arc; its chord is the arc's length times sinc(omega / 2) and points half the turn to the side,
    which is exact for every omega and needs no series near 0.

    Parameters
    ----------
    xi : (..., 3) float64
        Twists [v_x m, v_y m, omega rad] in the moving frame, omega any real number.

    Raises
    ------
    ArgumentError
        If the last dimension of `xi` is not 3.

    References
    ----------
    Sola et al., A micro Lie theory (2018), equations 156 and 158.
    """
    vx, vy, omega = _components(xi, "xi")
    c, s = _cos_sin(0.5 * omega)
    chord = _sinc(0.5 * omega)
    return _pose(chord * (c * vx - s * vy), chord * (s * vx + c * vy), omega)


@checked
def log(pose: ArrayLike) -> FloatArray:
    """Return twist (..., 3) [m, m, rad] whose `exp` is `pose` (..., 3), the one with omega in [-pi, pi).

    sinc(omega / 2) >= 2 / pi there, so the division is harmless near pi as well as near 0. Raises ArgumentError if the
    last dimension of `pose` is not 3.

    Source: Sola et al., A micro Lie theory (2018), equation 157.
    """
    x, y, theta = _components(pose, "pose")
    omega = wrap(theta)
    c, s = _cos_sin(0.5 * omega)
    chord = _sinc(0.5 * omega)
    return _pose((c * x + s * y) / chord, (c * y - s * x) / chord, omega)


@checked
def transform_points(pose: ArrayLike, points: ArrayLike) -> FloatArray:
    """Carry points from the frame of `pose` to the frame in which `pose` is given.

    Parameters
    ----------
    pose : (..., 3) float64
        Poses; for every one of N poses to carry all of B points, pass shapes (N, 1, 3) and (B, 2).
    points : (..., 2) float64, m

    Returns
    -------
    (..., 2) float64, m

    Raises
    ------
    ArgumentError
        If the last dimension is not 3 or 2.
    """
    x, y, theta = _components(pose, "pose")
    px, py = _components(points, "points", 2)
    c, s = _cos_sin(theta)
    return _stack(x + c * px - s * py, y + s * px + c * py)


@checked
def compose_jacobians(a: ArrayLike, b: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the Jacobians (..., 3, 3) of compose(a, b) with respect to `a` and to `b`.

    The second depends on the heading of `a` alone and has the leading dimensions of `a`. Raises ArgumentError if
    the last dimension of an argument is not 3.

    Source: Smith, Self and Cheeseman, Estimating uncertain spatial relationships in robotics (1990).
    """
    _, _, theta = _components(a, "a")
    bx, by, _ = _components(b, "b")
    c, s = _cos_sin(theta)
    return _matrix(1, 0, -s * bx - c * by, 0, 1, c * bx - s * by, 0, 0, 1), _matrix(c, -s, 0, s, c, 0, 0, 0, 1)


@checked
def adjoint(pose: ArrayLike) -> FloatArray:
    """Return the adjoint (..., 3, 3) of poses: pose compose exp(xi) = exp(adjoint @ xi) compose pose.

    Raises ArgumentError if the last dimension of `pose` is not 3.

    Source: Sola et al., A micro Lie theory (2018), equation 159.
    """
    x, y, theta = _components(pose, "pose")
    c, s = _cos_sin(theta)
    return _matrix(c, -s, y, s, c, -x, 0, 0, 1)


def rotate_covariances(covariances: FloatArray, angles: ArrayLike) -> FloatArray:
    """Rotate covariances, or information matrices, (..., 3, 3) of x, y and theta into other axes: R C R'.

    R rotates x and y by `angles` (...), rad: the heading, in the new axes, of the frame that they are given in.
    """
    angle = np.asarray(angles, np.float64)
    if covariances.ndim == 2 and (angle.ndim == 0 or angle.size > _MANY):
        return _rotate_covariance(covariances, angle if angle.ndim else angle.item())
    rotation = np.zeros((*angle.shape, 3, 3))
    rotation[..., 0, 0] = rotation[..., 1, 1] = np.cos(angle)
    rotation[..., 1, 0] = np.sin(angle)
    rotation[..., 0, 1] = -rotation[..., 1, 0]
    rotation[..., 2, 2] = 1.0
    return np.asarray(rotation @ covariances @ rotation.swapaxes(-1, -2))


def _rotate_covariance(covariance: FloatArray, angle: Component) -> FloatArray:
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = covariance.tolist()
    if type(angle) is not float and xx == yy and xy == xt == yt == 0:  # the same in any axes
        return np.tile(covariance, (*angle.shape, 1, 1))
    c, s = _cos_sin(angle)
    cc, cs, ss = c * c, c * s, s * s
    rxx = cc * xx - cs * (2 * xy) + ss * yy
    ryy = ss * xx + cs * (2 * xy) + cc * yy
    rxy = cs * (xx - yy) + (cc - ss) * xy
    rxt = c * xt - s * yt
    ryt = s * xt + c * yt
    return _matrix(rxx, rxy, rxt, rxy, ryy, ryt, rxt, ryt, tt)


@checked
def lever_arm_jacobian(frames: FloatArray, carried: FloatArray) -> FloatArray:
    """Return Jacobians of poses that a frame carries along when it moves, by the pose of that frame.

    Parameters
    ----------
    frames : (..., 3) float64
        Poses of the frames, map frame; leading dimensions broadcast to those of `carried`.
    carried : (..., 2 or more) float64
        Poses, or points, in the map frame, too.

    Returns
    -------
    (..., 3, 3) float64
        Of points the first two rows count.
    """
    jacobian = np.zeros((*carried.shape[:-1], 3, 3))
    jacobian[..., 0, 0] = jacobian[..., 1, 1] = jacobian[..., 2, 2] = 1.0
    jacobian[..., 0, 2] = frames[..., 1] - carried[..., 1]
    jacobian[..., 1, 2] = carried[..., 0] - frames[..., 0]
    return jacobian


def _components(values: ArrayLike, name: str, width: int = 3) -> Component:
    if type(values) is np.ndarray and values.shape == (width,) and values.dtype is _FLOAT64:
        return values.tolist()  # what a filter asks most
    array = np.asarray(values, dtype=np.float64)
    if array.ndim == 0 or array.shape[-1] != width:
        raise ArgumentError(name, f"shape (..., {width})", array.shape)
    return array.tolist() if array.ndim == 1 else [array[..., k] for k in range(width)]


def _cos_sin(angle: Component) -> tuple[Component, Component]:
    return (math.cos(angle), math.sin(angle)) if type(angle) is float else (np.cos(angle), np.sin(angle))


def _sinc(angle: Component) -> Component:
    """Return sin(angle) / angle, and 1 at 0."""
    if isinstance(angle, float):
        return math.sin(angle) / angle if angle else 1.0
    safe = np.where(angle == 0.0, 1.0, angle)
    return np.where(angle == 0.0, 1.0, np.sin(safe) / safe)


def _pose(x: Component, y: Component, theta: Component) -> FloatArray:
    """Put components of one shape (...) together."""
    if type(x) is type(theta) is float:
        return np.array((x, y, wrap(theta)))
    pose = np.empty((*theta.shape, 3))
    pose[..., 0] = x
    pose[..., 1] = y
    pose[..., 2] = wrap(theta)
    return pose


def _stack(*parts: Component) -> FloatArray:
    """Put components (...) along a new last axis."""
    if all(isinstance(part, float | int) for part in parts):
        return np.array(parts, dtype=np.float64)
    stacked = np.empty((*np.broadcast_shapes(*(np.shape(part) for part in parts)), len(parts)))
    for k, part in enumerate(parts):
        stacked[..., k] = part
    return stacked


def _matrix(*entries: Component) -> FloatArray:
    """Build matrices (..., 3, 3) from nine entries (...), row by row."""
    stacked = _stack(*entries)
    return stacked.reshape(*stacked.shape[:-1], 3, 3)
