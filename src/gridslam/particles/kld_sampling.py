"""KLD-sampling: how many particles a belief needs, by the number of places that it is spread over."""

from __future__ import annotations

import numpy as np

from gridslam.checked import checked
from gridslam.types import FloatArray, IntArray


@checked
def kld_bound(bins: IntArray, error: float, z: float) -> FloatArray:
    """Return how many particles (...) a belief spread over `bins` (...) needs; 0 for a single bin.

    With that many the Kullback-Leibler divergence of the sampled from the true histogram over the bins is below `error`
    with the probability of which `z` is the standard normal quantile: chi^2_{k-1, 1-delta} / (2 error), with Wilson and
    Hilferty's approximation of the chi-square quantile.

    Source: Probabilistic Robotics, Table 8.4; D. Fox, Adapting the sample size in particle filters through
    KLD-sampling, IJRR 22 (2003).
    """
    freedom = np.maximum(np.asarray(bins, dtype=np.float64) - 1, 0)
    ninth = 2 / (9 * np.maximum(freedom, 1))
    return np.asarray(np.ceil(freedom / (2 * error) * np.maximum(1 - ninth + np.sqrt(ninth) * z, 0) ** 3))
