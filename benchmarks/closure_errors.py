"""Closures against the truth: is the place that was recognized the place where the robot was?"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.types import FloatArray

FALSE_CLOSURE_M = 0.5
"""Farther than this from the truth a closure is false: it is ten cells, which no matcher errs by where it is right."""

FALSE_CLOSURE_RAD = math.radians(5.0)
"""Turned more than this from the truth a closure is false."""


OPEN_M = 1.0
"""A direction with a greater standard deviation is degenerate: errors of half a metre are not evaluated there."""


def closure_errors(
    truth: ArrayLike, edges: ArrayLike, measurements: ArrayLike, information: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return how far measured relative poses of pairs of scans are from the true ones.

    `truth` (N, 3) are true poses in any one frame, `edges` (M, 2) each closure's two scans, `measurements` (M, 3) the
    second seen from the first, `information` (M, 3, 3) as in a `PoseGraph`: if given, errors along degenerate
    directions are ignored, as along a bare corridor, where a match has no information. Metres (M,) are in the
    directions that count, radians (M,) in [0, pi].
    """
    poses = np.asarray(truth, np.float64)
    pairs = np.asarray(edges, np.int64).reshape(-1, 2)
    measured = np.asarray(measurements, np.float64).reshape(-1, 3)
    away = measured - between(poses[pairs[:, 0]], poses[pairs[:, 1]])
    metres = np.hypot(away[:, 0], away[:, 1])
    if information is not None:
        metres = _determined_m(away, measured, np.asarray(information, np.float64).reshape(-1, 3, 3))
    return metres, np.abs(wrap(away[:, 2]))


def _determined_m(away: FloatArray, measured: FloatArray, information: FloatArray) -> FloatArray:
    """Length (M,) of position errors (M, 3) in the directions in which the information is more than next to none."""
    c = np.cos(measured[:, 2])
    s = np.sin(measured[:, 2])
    end_from_start = np.array([[c, s], [-s, c]])  # the information is of the frame where a measurement ends
    known, axes = np.linalg.eigh(information[:, :2, :2])
    along = np.einsum("mij,ikm,mk->mj", axes, end_from_start, away[:, :2])
    return np.asarray(np.sqrt((np.square(along) * (known >= OPEN_M**-2)).sum(axis=1)))


def false_closures(
    truth: ArrayLike,
    edges: ArrayLike,
    measurements: ArrayLike,
    information: ArrayLike | None = None,
) -> NDArray[np.bool_]:
    """Which closures (M,) are false: farther from the truth than half a metre, or turned more than five degrees."""
    metres, radians = closure_errors(truth, edges, measurements, information)
    return np.asarray((metres > FALSE_CLOSURE_M) | (radians > FALSE_CLOSURE_RAD))
