"""KLD-sampling: as many particles as the belief needs."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from gridslam.parameters import bounded, parameters
from gridslam.particles.kld_sampling import kld_bound
from gridslam.types import FloatArray, IntArray, Resampler


@final
@parameters(frozen=True)
class KldSampling:
    """Resamples to the number of particles that keeps the error of the sample in bounds.

    Draws particles one by one and counts the bins (x, y, theta) that they fall into, until there are enough: with
    probability 1 - delta the Kullback-Leibler divergence of the sampled from the true belief, as histograms over these
    bins, is then below `error`. A belief at one place needs hundreds, one all over the map thousands.

    Parameters
    ----------
    particles_min, particles_max : int, >= 1
        Bounds that hold whatever the belief. A few hundred follow a robot; with 2000 chance seldom decides between two
        places that look alike before the scans do. 20000 take 10 ms an update.
    error : float, > 0
        Greatest divergence; the book's epsilon.
    z : float
        Upper 1 - delta quantile of the standard normal distribution; 2.33 for 99 %.
    bin_m, bin_rad : float, m and rad, > 0
        Sides of a bin; half a metre and ten degrees, as AMCL has them.

    References
    ----------
    Probabilistic Robotics, Table 8.4; D. Fox, Adapting the sample size in particle filters through
    KLD-sampling, IJRR 22 (2003).
    """

    particles_min: int = bounded(2000, ge=1, le=1_000_000)
    particles_max: int = bounded(20_000, ge=1, le=1_000_000)
    error: float = bounded(0.05, ge=1e-6, le=1e6)
    z: float = bounded(2.33, le=1e6)
    bin_m: float = bounded(0.5, ge=1e-6, le=1e6)
    bin_rad: float = bounded(math.radians(10), gt=0, le=math.tau)

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        if self.particles_min > self.particles_max:
            raise ValueError("particles_min must not exceed particles_max")

    def bins(self, poses: FloatArray) -> IntArray:
        """Name (N,) of the bin of each pose (N, 3); poses in one bin have the same name."""
        x, y = np.floor(poses[:, :2] / self.bin_m).astype(np.int64).T
        around = math.ceil(math.tau / self.bin_rad)
        turn = np.floor((poses[:, 2] + math.pi) / self.bin_rad).astype(np.int64) % around
        return np.asarray((x * (1 << 24) + y) * around + turn)

    def __call__(
        self, poses: FloatArray, weights: FloatArray, resampler: Resampler, rng: np.random.Generator
    ) -> IntArray:
        """Draw which of poses (N, 3) of weights (N,) survive: parents (M,) int64, ascending.

        How many is found by drawing one by one, at random; who, by a `resampler` of less variance.
        """
        return resampler(weights, self.size(poses, weights, rng), rng)

    def size(self, poses: FloatArray, weights: FloatArray, rng: np.random.Generator) -> int:
        """Find the number of particles to draw, by drawing until there are enough."""
        if self.particles_min == self.particles_max:
            return self.particles_max
        bins = self.bins(poses)
        ends = np.cumsum(weights)
        drawn = np.empty(0, np.int64)
        count = self.particles_min
        while True:
            points = rng.random(count - len(drawn)) * ends[-1]
            drawn = np.append(drawn, bins[np.minimum(ends.searchsorted(points, side="right"), len(bins) - 1)])
            enough = self._enough(drawn)
            if enough is not None or count >= self.particles_max:
                return min(enough or count, self.particles_max)
            count = min(2 * count, self.particles_max)

    def _enough(self, drawn: IntArray) -> int | None:
        """After how many draws there are first as many as the bins so far ask for; None where never."""
        first = np.sort(np.unique(drawn, return_index=True)[1])
        needed = np.maximum(first + 1, kld_bound(np.arange(1, len(first) + 1), self.error, self.z))
        needed = np.maximum(needed, self.particles_min)
        met = np.flatnonzero(needed <= np.append(first[1:], len(drawn)))
        return int(needed[met[0]]) if len(met) else None
