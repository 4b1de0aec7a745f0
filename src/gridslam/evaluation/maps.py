"""Errors of landmark maps: landmarks against the true ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.evaluation.trajectory import align
from gridslam.geometry.se2 import transform_points
from gridslam.types import FloatArray, IntArray

_FAR = 1000.0
"""Cost of no partner, as a ratio to the greatest distance of partners."""


@final
@dataclass(frozen=True, slots=True)
class LandmarkErrors:
    """How well landmarks were found.

    Attributes
    ----------
    found : int
        Landmarks of the truth that have a partner.
    missing : int
        Those that have none.
    surplus : int
        Landmarks in the map that have none: doubled, or of nothing.
    rmse_m, max_m : float, m
        Distances of partners after the map was moved to where it fits best.
    """

    found: int
    missing: int
    surplus: int
    rmse_m: float
    max_m: float


def pair_by_name(names: IntArray, true_names: IntArray) -> tuple[IntArray, IntArray]:
    """Return places (K,) in both of the names, each there once, that both have."""
    _, ours, theirs = np.intersect1d(names, true_names, assume_unique=True, return_indices=True)
    return ours, theirs


def pair_by_position(
    positions: FloatArray, truth: FloatArray, true_from_map: FloatArray, reach_m: float = 0.5
) -> tuple[IntArray, IntArray]:
    """Pair landmarks without comparable names, each once, so that as many as may be have a partner nearby.

    Parameters
    ----------
    positions, truth : (M, 2), (L, 2) float64, m
        Landmarks of the map and true ones.
    true_from_map : (3,) float64
        First guess of where the map lies; it is improved by the pairs as long as these change.
    reach_m : float, m
        Greatest distance of partners.

    Returns
    -------
    (K,) int64, (K,) int64
        Places of the partners.
    """
    from scipy.optimize import linear_sum_assignment  # only who compares maps pays for its import

    ours = theirs = np.zeros(0, np.int64)
    for _ in range(20):
        moved = transform_points(true_from_map, positions)
        distances = np.hypot(*(moved[:, None] - truth).transpose(2, 0, 1))
        before = ours, theirs
        ours, theirs = linear_sum_assignment(np.minimum(distances, _FAR * reach_m))
        near = distances[ours, theirs] <= reach_m
        ours, theirs = ours[near], theirs[near]
        if len(ours) < 2 or (np.array_equal(ours, before[0]) and np.array_equal(theirs, before[1])):
            break
        true_from_map = align(positions[ours], truth[theirs])
    return ours, theirs


def landmark_errors(positions: FloatArray, truth: FloatArray, pairs: tuple[IntArray, IntArray]) -> LandmarkErrors:
    """Distances of landmarks (M, 2) from true ones (L, 2), by pairs, after alignment on SE(2).

    Raises ArgumentError where there is no pair.
    """
    ours, theirs = pairs
    if not len(ours):
        raise ArgumentError("pairs", "at least one", "none")
    moved = transform_points(align(positions[ours], truth[theirs]), positions[ours])
    errors = np.hypot(*(moved - truth[theirs]).T)
    rmse = float(np.sqrt(np.mean(np.square(errors))))
    missing = len(truth) - len(ours)
    return LandmarkErrors(len(ours), missing, len(positions) - len(ours), rmse, float(errors.max()))
