"""Systematic errors of a laser, by how well the surfaces of key scans fit each other where they were adjusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.kernels.reference_surfaces import match_points
from gridslam.matching.surfaces import Surfaces
from gridslam.types import FloatArray, IntArray

_GATE_M = 0.08
"""Largest residual of a point."""
_SIGMA_M = 0.02
"""Standard deviation of a point; where the residual is as large, it weighs half."""
_MOST_PAIRS = 200
"""Of key scans, spread over the log, which determine a range to some millimetres."""
_BLOCKS = 25
"""Of consecutive pairs, whose errors are taken to be independent."""
_ROUNDS = 2
"""One finds seven eighths of an error, as poses were adjusted with it."""
_LEAST = 1e-6


@final
@dataclass(frozen=True, slots=True)
class LaserErrors:
    """What a laser's scans are off by, each with its standard deviation.

    Attributes
    ----------
    range_offset_m, range_offset_sigma_m : float, m
        What every range is too long by.
    bearing_scale, bearing_scale_sigma : float
        Share by which the angles between beams are too large: 0.0056 if 180 beams of 1 degree are spread over 181.
    """

    range_offset_m: float
    range_offset_sigma_m: float
    bearing_scale: float
    bearing_scale_sigma: float


def estimate_laser_errors(surfaces: Surfaces, poses: FloatArray, pairs: IntArray) -> LaserErrors | None:
    """Estimate the errors of the laser that has taken all scans.

    A range that is too long moves a wall away in proportion to the cosine of the beam's incidence, and an angle that is
    too large bends it: two scans from different places then cannot fit, wherever they are put. The errors are the least
    squares solution over pairs of scans, each pair put where it fits best. A wrong scale of ranges changes nothing but
    the scale of the map, and a wrong direction of the laser nothing at all: these the odometry shows.

    Parameters
    ----------
    surfaces, poses : Surfaces, (T, 3) float64
        Of the key scans, adjusted.
    pairs : (P, 2) int64
        Key scans that see the same surfaces.

    Returns
    -------
    LaserErrors or None
        None if there are few pairs, several lasers, or nothing that determines the errors.

    References
    ----------
    Huber and Ronchetti, Robust Statistics (2009), for the standard deviations (sandwich, by blocks of pairs).
    """
    if len(pairs) < _BLOCKS or np.ptp(surfaces.origins, axis=0).max() > 0:
        return None
    pairs = pairs[:: -(-len(pairs) // _MOST_PAIRS)]
    matched = _match(surfaces, _derivatives(surfaces), poses, pairs)
    errors, whole, left = np.zeros(2), np.empty((2, 2)), np.empty((0, 2))
    for _ in range(_ROUNDS):
        sums = [_sum(rows, variances, errors) for rows, variances in matched]
        normals, pulls = (np.array(each) for each in zip(*sums, strict=True))
        whole = normals.sum(axis=0)
        if np.linalg.eigvalsh(whole)[0] < _LEAST:
            return None
        step = np.linalg.solve(whole, pulls.sum(axis=0))
        errors += step
        left = pulls - normals @ step
    begins = np.linspace(0, len(pairs), _BLOCKS, endpoint=False).astype(np.int64)
    shares = np.linalg.solve(whole, np.add.reduceat(left, begins).T)
    (offset, scale), (offset_sigma, scale_sigma) = errors.tolist(), np.sqrt(np.square(shares).sum(axis=1)).tolist()
    return LaserErrors(offset, offset_sigma, scale, scale_sigma)


def _derivatives(surfaces: Surfaces) -> FloatArray:
    """Derivatives (B, 2, 2) of points by the errors."""
    x, y = (surfaces.points - np.repeat(surfaces.origins, np.diff(surfaces.starts), axis=0)).T
    bearings = np.arctan2(y, x)
    ranges = np.maximum(np.hypot(x, y), _LEAST)
    return np.stack([x / ranges, -bearings * y, y / ranges, bearings * x], axis=1).reshape(-1, 2, 2)


def _match(
    surfaces: Surfaces, by_errors: FloatArray, poses: FloatArray, pairs: IntArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Derivatives of each pair's residuals by its relative pose and the errors, and these, (K, 6); variances (K,)."""
    parts = []
    for order in (pairs, pairs[:, ::-1]):
        found = match_points(surfaces, poses, order, _GATE_M, by_incidence=True)
        pose = found.slopes if order is pairs else found.slopes_of_fixed
        errors = np.einsum("ki,kij->kj", found.towards, by_errors[found.points])
        errors -= np.einsum("ki,kij->kj", found.normals, by_errors[found.lines])
        parts.append((found.pairs, np.column_stack([pose, errors, found.residuals]), found.variances))
    pair, rows, variances = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.argsort(pair, kind="stable")
    ends = np.cumsum(np.bincount(pair, minlength=len(pairs)))[:-1]
    return list(zip(np.split(rows[order], ends), np.split(variances[order], ends), strict=True))


def _sum(rows: FloatArray, variances: FloatArray, known: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal equations (2, 2), (2,) of what is left of the errors by a pair, whose relative pose is free."""
    residuals = rows[:, 5] - rows[:, 3:5] @ known
    weights = 1 / (variances + np.square(residuals / _SIGMA_M))
    equations = (rows[:, :5] * weights[:, None]).T @ np.column_stack([rows[:, :5], residuals])
    free = np.linalg.solve(equations[:3, :3] + _LEAST * np.eye(3), equations[:3, 3:])
    kept = equations[3:, 3:] - equations[3:, :3] @ free
    return kept[:, :2], kept[:, 2]
