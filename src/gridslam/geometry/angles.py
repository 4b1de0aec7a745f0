"""Angles on the circle; the one place that brings an angle back to [-pi, pi)."""

from __future__ import annotations

import math
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import describe
from gridslam.checked import checked
from gridslam.errors import ArgumentError

__all__ = ["normalize_weights", "wrap"]

FloatArray = NDArray[np.float64]


@overload
def wrap(angle: float) -> float: ...
@overload
def wrap(angle: NDArray[Any]) -> FloatArray: ...
def wrap(angle: float | NDArray[Any]) -> Any:
    """Bring angles to [-pi, pi).

    `fmod` and a subtraction of nearby numbers are all it takes, both exact in floating point: an angle already in the
    interval comes back bit for bit, +pi becomes -pi, and no rounding can lead out of the interval. Where all angles are
    less than a turn out of it the subtraction is enough, and where all are in it a copy.

    Parameters
    ----------
    angle : float or array of any shape, rad
        Finite; NaN stays NaN.

    Returns
    -------
    float, or array of the same shape, float64, rad
        `angle` minus a whole number of turns (2 * math.pi as a double).
    """
    if type(angle) is float and -math.pi <= angle < math.pi:
        return angle
    if isinstance(angle, float | int):
        if -math.pi <= angle < math.pi:
            return float(angle)
        if math.isinf(angle):
            raise ArgumentError("angle", "a finite angle", angle)
        rest = math.fmod(angle, math.tau)
        return rest - math.tau if rest >= math.pi else rest + math.tau if rest < -math.pi else rest
    if not isinstance(angle, np.ndarray | np.number) or angle.dtype.kind not in "fiu":
        raise ArgumentError("angle", "an angle, or an array of them", describe(angle))
    greatest = np.abs(angle).max(initial=0.0)
    if greatest < math.pi:
        return angle.astype(np.float64)
    remainder = angle if greatest < 1.5 * math.tau else np.fmod(angle, math.tau, dtype=np.float64)
    turns = np.subtract(remainder >= math.pi, remainder < -math.pi, dtype=np.float64)
    return remainder - math.tau * turns


@checked
def normalize_weights(weights: ArrayLike) -> FloatArray:
    """Divide weights (..., N) by their sum over the last axis.

    They are divided by the greatest first, so that the sum neither overflows nor drowns in subnormal numbers. Raises
    ArgumentError if there is none, one is negative or not finite, or all are 0.
    """
    given = np.asarray(weights, dtype=np.float64)
    if given.ndim == 0 or given.shape[-1] == 0:
        raise ArgumentError("weights", "shape (..., N) with N >= 1", given.shape)
    greatest = given.max(axis=-1, keepdims=True)
    if not (np.isfinite(given).all() and (given >= 0).all() and (greatest > 0).all()):
        raise ArgumentError("weights", "finite values >= 0, not all 0", given)
    scaled = given / greatest
    return np.asarray(scaled / scaled.sum(axis=-1, keepdims=True))
