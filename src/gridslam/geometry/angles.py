"""Angles on the circle; the one place that brings an angle back to [-pi, pi)."""

from __future__ import annotations

import math
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import describe
from gridslam.checked import checked
from gridslam.errors import ArgumentError

FloatArray = NDArray[np.float64]

_ONE_WAY_RAD = 1e-4  # a laser's beams are spread over more
_MOST_TURNS = 3.5  # larger angles are degrees; smaller ones may come of a wrong factor, of two or three
_UNEVEN = 0.02  # of the sweep: drivers round the increment, and some count other beams than they send
_OFF_BY_ONE = 1.5  # increments: angle_max is that of the last beam, or of the one that would follow


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
def wrap_headings(poses: FloatArray) -> FloatArray:
    """Return poses (..., 3), or sums or differences of them, with headings in [-pi, pi)."""
    wrapped = np.array(poses, np.float64)
    wrapped[..., 2] = wrap(wrapped[..., 2])
    return wrapped


@checked
def find_wrong_beam_angles(start: float, step: float, beams: int, end: float = math.nan) -> str:
    """Describe why no laser has such beams; empty for those of one.

    Parameters
    ----------
    start, step : float, rad
        Bearing of the first beam (angle_min), and from each beam to the next (angle_increment).
    beams : int
        Their number.
    end : float, rad
        Bearing of the last beam as stated (angle_max); NaN, 0 or that of the first, where nothing is stated: drivers
        leave it out. It may be that of the beam that would follow, and a whole turn away.

    Returns
    -------
    str
        What was expected and what came: angles that are not finite or in degrees, beams that all point one way or over
        more than a turn, or a stated end that contradicts the others.
    """
    if beams < 2:
        return ""
    sweep = step * (beams - 1)
    came = f"{beams} beams from angle_min {start:g} in steps of angle_increment {step:g} rad"
    if not math.isfinite(start + sweep):
        return f"expected finite angles, got {came}"
    if not abs(sweep) > _ONE_WAY_RAD:
        return f"expected beams in different directions, got {came}: all point one way"
    slack = _OFF_BY_ONE * abs(step) + _UNEVEN * abs(sweep)
    is_wide = abs(sweep) > math.tau + slack
    stated = 0.0 if math.isnan(end) or end == 0 else end - start
    turns = (0,) if is_wide else (-1, 0, 1)
    agrees = stated == 0 or any(abs(stated + turn * math.tau - sweep) <= slack for turn in turns)
    in_degrees = max(abs(start), abs(sweep), abs(stated)) > _MOST_TURNS * math.tau
    if not agrees:
        came += f", which end at {start + sweep:g} rad, not at angle_max {end:g}"
    elif is_wide:
        came += ", more than one turn"
    elif not in_degrees:
        return ""
    came += ": the angles look like degrees" if in_degrees else ""
    return f"expected angles in rad that fit each other, got {came}"
