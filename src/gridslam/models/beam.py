"""Beam model of a range finder: each range is explained along its ray through the map."""

from __future__ import annotations

import math
from functools import cache
from typing import final

import numpy as np

from gridslam.checked import checked
from gridslam.geometry.se2 import transform_points
from gridslam.parameters import bounded, parameters
from gridslam.types import Beams, BeamStatus, DistanceMaps, FloatArray, Rows, ScanLikelihood

_REACH = 6.0  # standard deviations beyond which a Gaussian's tail, 1e-9, counts as nothing


def _normal_cdf(scores: FloatArray | float) -> FloatArray:
    """Return standard normal distribution function, by linear interpolation in a table: within 2e-7."""
    return np.asarray(np.interp(scores, *_tabulate_normal_cdf()))


@cache
def _tabulate_normal_cdf() -> tuple[FloatArray, FloatArray]:
    scores = np.linspace(-_REACH, _REACH, 4801)
    return scores, np.array([0.5 * math.erfc(-score / math.sqrt(2)) for score in scores])


@final
@checked
@parameters(frozen=True)
class BeamRangeFinder:
    """Beam model: a range is the obstacle on the ray, something before it, no return at all, or random.

    p(z) is a density (1/m) for 0 <= z < range_max and a probability for a beam without return; for every ray through
    the map the two add up to 1. `likelihoods` gives it for ranges and expected ranges.

    Parameters
    ----------
    z_hit, z_short, z_max, z_rand : float, [0, 1]
        Shares of the four explanations; they sum to 1.
    sigma_hit_m : float, m, > 0
        Standard deviation of a range around the expected one. The default is two cells of 5 cm: the map's walls are
        no sharper than that.
    lambda_short_per_m : float, 1/m, > 0
        Rate at which unexpected objects (people) stop the beam; 1 puts them a metre away on the average.
    range_max_m : float, m, > 0
        Range from which on the sensor reports no return.
    tempering : float, (0, 1]
        Factor on the log likelihood: the share of a beam's evidence that is new; 1 takes all beams as independent, as
        the book does.

    Raises
    ------
    ConfigurationError
        The shares do not sum to 1, or z_rand or z_max is 0 (then one beam could make a pose impossible).

    Notes
    -----
    The book cuts the Gaussian off at range_max and scales up what is left. Here what lies beyond counts as no return,
    because that is what the sensor then reports: a ray into the open expects nothing back.

    References
    ----------
    Probabilistic Robotics, Table 6.1 (`beam_range_finder_model`), Equations 6.4 to 6.12.
    """

    z_hit: float = bounded(0.8, ge=0, le=1)
    z_short: float = bounded(0.1, ge=0, le=1)
    z_max: float = bounded(0.05, ge=1e-6, le=1)
    z_rand: float = bounded(0.05, ge=1e-6, le=1)
    sigma_hit_m: float = bounded(0.1, ge=1e-6, le=100)
    lambda_short_per_m: float = bounded(1.0, ge=1e-6, le=1e6)
    range_max_m: float = bounded(30.0, ge=1e-6, le=1000)
    tempering: float = bounded(1.0, ge=1e-6, le=1)

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        if abs(self.z_hit + self.z_short + self.z_max + self.z_rand - 1) > 1e-9:
            raise ValueError("z_hit, z_short, z_max and z_rand must sum to 1")

    def likelihoods(self, ranges: FloatArray | float, expected: FloatArray | float) -> FloatArray:
        """Evaluate p(z | expected range), broadcast.

        Parameters
        ----------
        ranges : (...) float64, m, >= 0
            Measured ranges; `range_max_m` or more means no return.
        expected : (...) float64, m, >= 0
            Range to the map's first obstacle on the ray; infinity where there is none.

        Returns
        -------
        (...) float64
            Densities in 1/m for ranges below `range_max_m`, probabilities for the others.
        """
        sigma = self.sigma_hit_m
        ranges = np.minimum(ranges, self.range_max_m)
        seen = _normal_cdf(expected / sigma)  # the Gaussian's mass at positive ranges, at least 1/2
        beyond = _normal_cdf((expected - self.range_max_m) / sigma) / seen
        no_return = self.z_max + self.z_hit * beyond
        hit = np.exp(-0.5 * np.square((ranges - expected) / sigma)) / (math.sqrt(math.tau) * sigma * seen)
        rate = self.lambda_short_per_m
        before = np.clip(expected, 1e-6, self.range_max_m)
        short = np.where(ranges <= before, rate * np.exp(-rate * ranges) / -np.expm1(-rate * before), 0.0)
        density = self.z_hit * hit + self.z_short * short + self.z_rand / self.range_max_m
        return np.where(ranges < self.range_max_m, density, no_return)

    def __call__(self, beams: Beams) -> ScanLikelihood:
        """Condition on the given beams and, where these are not all, on as many of those without return."""
        scan = beams.scan
        hits, silent = (np.flatnonzero(scan.status == status) for status in (BeamStatus.HIT, BeamStatus.NO_RETURN))
        used = np.union1d(beams.indices, silent[:: max(1, round(len(hits) / max(len(beams), 1)))])
        ranges = np.where(scan.status == BeamStatus.NO_RETURN, self.range_max_m, scan.ranges)[used]
        projected = scan.geometry.directions[used]
        if beams.turn_rate_rps and scan.beam_times_s is not None:
            turns = np.zeros((len(used), 3))
            turns[:, 2] = beams.turn_rate_rps * scan.beam_times_s[used]
            projected = transform_points(turns, projected)
        level = np.maximum(np.hypot(projected[:, 0], projected[:, 1]), 1e-9)  # 1 unless the laser is tilted
        directions = projected / level[:, None]
        look = self.range_max_m + _REACH * self.sigma_hit_m  # an obstacle beyond is as good as none

        def log_likelihood(maps: DistanceMaps, rows: Rows, poses: FloatArray) -> FloatArray:
            expected = maps.cast_rays(rows, poses, beams.origin, directions, look).astype(np.float64)
            return np.asarray(self.tempering * np.log(self.likelihoods(ranges, expected / level)).sum(axis=1))

        return log_likelihood
