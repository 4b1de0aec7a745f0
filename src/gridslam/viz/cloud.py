"""A cloud of many particles, represented by few."""

from __future__ import annotations

import numpy as np

from gridslam.types import FloatArray, IntArray

MOST_SHOWN = 1000
"""Particles of a cloud that are shown: an eye sees no more of them, and a line to it need not carry them."""


def select_representatives(weights: FloatArray, most: int = MOST_SHOWN) -> tuple[IntArray, FloatArray]:
    """Select particles that represent a cloud, with their shares; all particles where there are at most `most`.

    Parameters
    ----------
    weights : (N,) float64
        Of the particles; they sum to 1.
    most : int, >= 1
        How many there may be.

    Returns
    -------
    chosen : (K,) int64
        Indices in ascending order: evenly spaced along the cumulative weights, so that K / `most` of a place's weight
        is represented to within 1 / `most`, and without chance.
    shares : (K,) float64
        The weight for which each stands; they sum to 1.
    """
    if len(weights) <= most:
        return np.arange(len(weights)), weights
    ends = np.cumsum(weights)
    picked = np.searchsorted(ends, (np.arange(most) + 0.5) * (ends[-1] / most), side="right")
    chosen, counts = np.unique(np.minimum(picked, len(weights) - 1), return_counts=True)
    return chosen, counts / most
