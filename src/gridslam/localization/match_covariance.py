"""Covariance of a pose at which a scan was matched to a known map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from gridslam.geometry.se2 import transform_points
from gridslam.localization.known_map import KnownMap
from gridslam.matching.gauss_newton import GaussNewton, cauchy_weights, degenerate_direction, evaluating
from gridslam.types import Beams, FloatArray

_PATCH_M = 0.5
"""Side of a patch: ten cells of 5 cm."""

_RESIDUAL_FACTOR = 3.0
"""Ratio of the map's errors to the residuals. Errors that neighbouring ends share move the pose, and are no residuals.
Measured with the true poses of eight simulated buildings (seeds 0 to 7), in all of which the normalized estimation
error squared is between 1.6 and 3.1 by it; 3 degrees of freedom are expected."""


def compute_match_covariance(
    known_map: KnownMap, matcher: GaussNewton, pose: FloatArray, belief: FloatArray, beams: Beams
) -> FloatArray:
    """Covariance (3, 3) of a pose (3,) that `matcher` found, where the belief about it has a covariance (3, 3).

    It is (Sigma^-1 + H / s^2)^-1. H is the normal matrix of the match. Ends in one place share the map's error there,
    so only one end of each square patch of the map counts in it. s^2 is the variance of the distance between an end and
    the map: that of rounding the map to cells, and that of the residuals, as of an M-estimator. Along a degenerate
    direction, in which the match keeps the belief's mean, H is 0.

    References
    ----------
    P. Huber, Robust Statistics (1981), Section 7.6 (covariance of M-estimates).
    """
    column, row = np.floor(transform_points(pose, beams.ends) / _PATCH_M).astype(np.int64).T
    first = np.unique(column * (1 << 24) + row, return_index=True)[1]
    one_each = replace(beams, indices=beams.indices[first], ends=beams.ends[first])
    match = known_map.match(evaluating(matcher), pose[None], np.zeros((3, 3)), one_each)
    information = match.information[0]
    direction = degenerate_direction(information, float(match.score[0]), matcher.min_information)
    if direction is not None:
        across = np.eye(3)
        across[:2, :2] -= np.outer(direction, direction)
        information = across @ information @ across
    variance = _variance_m2(known_map, matcher, pose, beams)
    return np.asarray(np.linalg.inv(np.linalg.inv(belief) + information / variance))


def _variance_m2(known_map: KnownMap, matcher: GaussNewton, pose: FloatArray, beams: Beams) -> float:
    distances = known_map.distances(np.zeros(1, np.int32), pose[None], beams.ends)[0]
    weights = cauchy_weights(distances, matcher.cauchy_m)
    rounding = known_map.resolution_m / math.sqrt(12)
    residual = math.sqrt(float(np.square(weights * distances).mean())) / float(weights.mean())
    return rounding**2 + (_RESIDUAL_FACTOR * residual) ** 2
