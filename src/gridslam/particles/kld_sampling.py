"""KLD-sampling: how many particles a belief needs, by the number of places that it is spread over."""

from __future__ import annotations

import math
from typing import Protocol, final

import numpy as np

from gridslam.checked import checked
from gridslam.geometry.angles import wrap
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, IntArray

__all__ = ["FixedNumber", "KldNumber", "ParticleNumber", "kld_bound"]

_LEAST_CHANGE = 1.5
"""Ratio of numbers from which on a change is worth the diversity that a resampling costs."""


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


class ParticleNumber(Protocol):
    """Decides how many particles there are after a key scan."""

    def __call__(self, poses: FloatArray, log_weights: FloatArray, most: int) -> int:
        """Choose the number of particles of the next step.

        Parameters
        ----------
        poses : (N, 3) float64
            The particles [x m, y m, theta rad], map frame.
        log_weights : (N,) float64, nats
            Normalized.
        most : int, >= 1
            What the user asked for.

        Returns
        -------
        int
            N where a change is not worth a resampling; else the number to resample to.
        """
        ...


@final
@checked
@parameters(frozen=True)
class FixedNumber:
    """As many particles as there are. The default."""

    def __call__(self, poses: FloatArray, log_weights: FloatArray, most: int) -> int:
        """Return the number of `poses`."""
        return len(poses)


@final
@checked
@parameters(frozen=True)
class KldNumber:
    """As many particles as the spread of their poses needs: more before a loop closes, few once it has.

    What particles are for is to close loops: where the robot comes back, one of them must be so near that its scan
    matches the walls that it mapped then. Particles that the matcher moves to the same peak close a loop alike: they
    are one hypothesis, and a bin is as large as that. The number is KLD-sampling's for the bins that are occupied.
    While the robot explores, particles drift apart and occupy more bins, and become more: copies of a particle share
    its past, but not the drift to come, and the earlier they are made the more of the way is theirs. On known ground
    the spread does not grow. When a loop has closed or was corrected, the poses agree, and few go on.

    Those are drawn by the filter's resampler in proportion to their weights: the same belief by fewer samples. As a
    resampling costs diversity, a number that is off by less than a half is left alone.

    Parameters
    ----------
    particles_min : int, >= 1
        How many go on where all are in one bin; never more than the number that the user asked for. They explore until
        their spread shows: on ACES without loop closure one seed of five lost a loop with 6, and none of ten with 8.
    error : float, > 0, nats
        Greatest Kullback-Leibler divergence. Beyond 0.5 no number grows: k particles in k bins would ask for k.
    z : float
        Upper 1 - delta quantile of the standard normal distribution; 2.33 for 99 %.
    bin_m, bin_rad : float, m and rad, > 0
        Sides of a bin; a beam 0.1 m off a wall, or 2 m long at 0.05 rad, has lost half of its pull in the matcher.
        Bins are laid about the mean pose: particles within half a side of it share one.

    References
    ----------
    Probabilistic Robotics, Table 8.4; D. Fox, IJRR 22 (2003). There particles are drawn one by one until there are
    enough; here nothing is drawn: a bin counts if a resampling would rather keep it than not.
    """

    particles_min: int = bounded(8, ge=1, le=100_000)
    error: float = bounded(0.3, ge=1e-6, le=0.5)
    z: float = bounded(2.33, ge=0, le=10)
    bin_m: float = bounded(0.1, ge=1e-6, le=1e6)
    bin_rad: float = bounded(0.05, gt=0, le=math.tau)

    def __call__(self, poses: FloatArray, log_weights: FloatArray, most: int) -> int:
        """Return the number of particles of the next step; see `ParticleNumber`."""
        count = len(poses)
        needed = int(kld_bound(np.array(self.count_bins(poses, log_weights)), self.error, self.z))
        needed = min(max(needed, self.particles_min), most)
        if needed != most and max(needed, count) < _LEAST_CHANGE * min(needed, count):
            return count
        return needed

    def count_bins(self, poses: FloatArray, log_weights: FloatArray) -> int:
        """Count the bins of particles (N, 3), of normalized log weights (N,), that weigh half an even share or more."""
        weights = np.exp(log_weights)
        away = poses - poses[0]
        away[:, 2] = wrap(away[:, 2])
        away -= weights @ away
        places = np.floor(away / (self.bin_m, self.bin_m, self.bin_rad) + 0.5)
        _, bins = np.unique(places, axis=0, return_inverse=True)
        shares = np.bincount(bins.reshape(-1), weights)
        return int(np.count_nonzero(shares >= 0.5 / len(poses)))
