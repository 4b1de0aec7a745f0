"""End-point measurement models: evaluate only the distance from each end point to the nearest occupied cell."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.checked import checked
from gridslam.parameters import bounded, parameters
from gridslam.types import Beams, DistanceMaps, FloatArray, Rows, ScanLikelihood


@final
@checked
@parameters(frozen=True)
class LikelihoodField:
    """Likelihood field model: p(z) = z_hit N(d; 0, sigma_hit^2) + z_rand / range_max for each beam that hit something.

    Beams without a return carry no end point and are left out, as in the book; z_max is their ratio to all beams.

    Parameters
    ----------
    z_hit, z_rand, z_max : float, [0, 1]
        Shares of measured obstacles, of random readings and of missing returns; they sum to 1. The default of z_rand
        is one reading in twenty, which bounds what a person or a moved chair can cost.
    sigma_hit_m : float, m, > 0
        Standard deviation of an end's distance to the obstacle. Beyond the map's `reach_m` distances are capped:
        keep it below a third of that. The default is two cells of 5 cm.
    range_max_m : float, m, > 0
        Range over which random readings are uniform; use the largest range that beams are used at.
    tempering : float, (0, 1]
        Factor on the log likelihood: the share of a beam's evidence that is new. 1 takes all beams as independent, as
        the book does; neighbouring beams are not, and a smaller value keeps the belief from collapsing.

    Raises
    ------
    ConfigurationError
        The shares do not sum to 1, or z_rand is 0 (then one beam could make a pose impossible).

    References
    ----------
    Probabilistic Robotics, Table 6.3 (`likelihood_field_range_finder_model`).
    """

    z_hit: float = bounded(0.95, ge=0, le=1)
    z_rand: float = bounded(0.05, ge=1e-6, le=1)
    z_max: float = bounded(0.0, ge=0, le=1)
    sigma_hit_m: float = bounded(0.1, ge=1e-6, le=100)
    range_max_m: float = bounded(30.0, ge=1e-6, le=1e4)
    tempering: float = bounded(1.0, ge=1e-6, le=1)

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        if abs(self.z_hit + self.z_rand + self.z_max - 1) > 1e-9:
            raise ValueError("z_hit, z_rand and z_max must sum to 1")

    def log_likelihoods(self, distances: NDArray[np.float32]) -> NDArray[np.float32]:
        """Log likelihood of a beam for the distance (...) in m of its end to the nearest obstacle, before tempering."""
        peak = np.float32(self.z_hit / (math.sqrt(math.tau) * self.sigma_hit_m))
        exponent = np.float32(-0.5 / self.sigma_hit_m**2)
        uniform = np.float32(self.z_rand / self.range_max_m)
        return np.asarray(np.log(peak * np.exp(exponent * np.square(distances)) + uniform))

    def __call__(self, beams: Beams) -> ScanLikelihood:
        """Condition on the beams of one scan."""
        return _sum_over_ends(self.log_likelihoods, beams.ends, self.tempering)


@final
@checked
@parameters(frozen=True)
class CauchyEndPoint:
    """How many beams agree with the map: log weight = tempering * sum over beams of 1 / (1 + (d / scale)^2).

    A beam far from every obstacle costs at most one agreement, so people and moved furniture do not decide.

    Parameters
    ----------
    scale_m : float, m, > 0
        Distance at which a beam agrees by half; 0.1 m is two cells of 5 cm, the match's own robust scale.
    tempering : float, (0, 1]
        Share of a beam's evidence that is new. Neighbouring beams see the same wall and the same error of the map: as
        independent evidence they would leave one particle alive. It depends on the sensor and the world, not on how
        many particles there are. 0.03 leaves 5 of 180 beams: resampling is then rare enough that the particles which
        will close a loop are alive when it closes (ACES, thirty seeds; at 0.1 three in ten were not); the Intel log
        does not care between 0.03 and 0.3.

    Notes
    -----
    A heuristic: the exponential of a robust score, not a density of the ranges.

    References
    ----------
    The weight function of the Cauchy estimator, Z. Zhang, Parameter estimation techniques: a tutorial with
    application to conic fitting, Image and Vision Computing 15 (1997), Table 1.
    """

    scale_m: float = bounded(0.1, ge=1e-6, le=1e6)
    tempering: float = bounded(0.03, ge=1e-6, le=1)

    def log_likelihoods(self, distances: NDArray[np.float32]) -> NDArray[np.float32]:
        """Agreement of a beam for the distance (...) in m of its end to the nearest obstacle, before tempering."""
        agreement = np.square(distances)
        agreement *= np.float32(1 / self.scale_m**2)
        agreement += np.float32(1)
        return np.asarray(np.reciprocal(agreement))

    def __call__(self, beams: Beams) -> ScanLikelihood:
        """Condition on the beams of one scan."""
        return _sum_over_ends(self.log_likelihoods, beams.ends, self.tempering)


@final
@checked
@parameters(frozen=True)
class GMappingEndPoint:
    """GMapping's likelihood: minus the squared distance to the map within a small window, a fixed penalty outside.

    Parameters
    ----------
    scale_m2 : float, m^2, > 0
        What squared distances are divided by; GMapping's `lsigma` (twice the variance of an end point).
    miss_penalty_m2 : float, m^2, >= 0
        Squared distance charged to a beam with no occupied cell in the window; 0.5 in GMapping.
    kernel_m : float, m, > 0
        Radius of the window; 1.5 cells of 5 cm, half the width of the square that GMapping searches with its
        `kernelSize` of 1.
    skip : int, >= 0
        Beams left out between two used ones, counted over the whole scan; GMapping's `lskip`.
    likelihood_gain : float, > 0
        What the sum is divided by to smooth the weights; GMapping's `ogain` (3) times its number of particles, which is
        why there more particles mean a flatter posterior. Here the number of particles enters only if given so.

    Notes
    -----
    GMapping measures to the mean of the points that fell into a cell, this model to what `DistanceMaps` holds, the
    cell's centre.

    References
    ----------
    G. Grisetti, C. Stachniss, W. Burgard, GMapping (OpenSLAM), `ScanMatcher::likelihoodAndScore`.
    """

    scale_m2: float = bounded(0.075, ge=1e-9, le=1e4)
    miss_penalty_m2: float = bounded(0.5, ge=0, le=1e4)
    kernel_m: float = bounded(0.075, ge=1e-6, le=100)
    skip: int = bounded(0, ge=0, le=1000)
    likelihood_gain: float = bounded(3.0, ge=1e-6, le=1e6)

    def _charges_m2(self, distances: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return squared distance charged to a beam for the distance (...) in m of its end to the nearest obstacle."""
        near = distances <= np.float32(self.kernel_m)
        return np.where(near, np.square(distances), np.float32(self.miss_penalty_m2))

    def __call__(self, beams: Beams) -> ScanLikelihood:
        """Condition on the beams of one scan."""
        ends = beams.ends[beams.indices % (self.skip + 1) == self.skip]
        return _sum_over_ends(self._charges_m2, ends, -1 / (self.scale_m2 * self.likelihood_gain))


def _sum_over_ends(
    of_each: Callable[[NDArray[np.float32]], NDArray[np.float32]], ends: FloatArray, factor: float
) -> ScanLikelihood:
    """Condition on beams that end at (B, 2): `factor` times the sum of a function of each end's distance."""

    def log_likelihood(maps: DistanceMaps, rows: Rows, poses: FloatArray) -> FloatArray:
        return np.asarray(factor * of_each(maps.distances(rows, poses, ends)).sum(axis=1, dtype=np.float64))

    return log_likelihood
