"""Importance weights, kept as logarithms because their products underflow within a few hundred beams."""

from __future__ import annotations

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.types import FloatArray

__all__ = ["effective_sample_size", "entropy", "normalize", "relative_to_greatest"]


def normalize(log_weights: FloatArray) -> FloatArray:
    """Shift log weights so that the weights sum to 1.

    Parameters
    ----------
    log_weights : (N,) float64, nats
        Below +inf; -inf is a weight of 0.

    Returns
    -------
    (N,) float64, nats
        log_weights - log(sum(exp(log_weights))), computed about the greatest, so that no range is too wide.

    Raises
    ------
    ArgumentError
        If there is no weight, one is NaN or +inf, or all are -inf: then the belief is empty and cannot be repaired.
    """
    weights, shifted = _relative(log_weights)
    return np.asarray(shifted - np.log(weights.sum()))


def effective_sample_size(log_weights: FloatArray) -> float:
    """Effective sample size 1 / sum(w^2) of the normalized weights.

    From 1, where one particle holds all, to N, where all are equal. `log_weights` (N,) need not be normalized; raises
    as `normalize` does.

    Source: Liu, Metropolized independent sampling with comparisons to rejection sampling and importance sampling
    (1996); used for selective resampling by Grisetti et al. (T-RO 2007).
    """
    weights, _ = _relative(log_weights)
    return float(weights.sum() ** 2 / np.square(weights).sum())


def entropy(log_weights: FloatArray) -> float:
    """Shannon entropy of the normalized weights in nats, from 0 (one particle holds all) to log(N) (all are equal).

    `log_weights` (N,) need not be normalized; raises as `normalize` does.
    """
    weights, shifted = _relative(log_weights)
    total = weights.sum()
    drawn = weights > 0
    return float(np.log(total) - weights[drawn] @ shifted[drawn] / total)


def relative_to_greatest(log_weights: FloatArray) -> FloatArray:
    """Shift log weights (N,), in nats, so that the greatest is 0."""
    shifted: FloatArray = log_weights - log_weights.max()
    return shifted


def _relative(log_weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weights relative to the greatest, and their logarithms."""
    given = np.asarray(log_weights, dtype=np.float64)
    if given.ndim != 1 or len(given) == 0:
        raise ArgumentError("log_weights", "shape (N,) with N >= 1", given.shape)
    greatest = given.max()
    if not np.isfinite(greatest):
        raise ArgumentError("log_weights", "no NaN, none +inf and not all -inf", f"a greatest value of {greatest}")
    with np.errstate(over="ignore"):  # a difference beyond the number range is a weight of 0 all the same
        shifted = given - greatest
    return np.exp(shifted), shifted
