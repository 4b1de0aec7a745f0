"""Likelihood field: a beam's end is normally distributed around the nearest obstacle, or anywhere."""

from __future__ import annotations

import math
from typing import final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass as parameters

from gridslam.models.parameters import STRICT
from gridslam.types import Beams, DistanceMaps, FloatArray, Rows, ScanLikelihood

__all__ = ["LikelihoodField"]


@final
@parameters(frozen=True, config=STRICT)
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
    pydantic.ValidationError
        The shares do not sum to 1, or z_rand is 0 (then one beam could make a pose impossible).

    Source: Probabilistic Robotics, Table 6.3 (`likelihood_field_range_finder_model`).
    """

    z_hit: float = Field(default=0.95, ge=0, le=1)
    z_rand: float = Field(default=0.05, gt=0, le=1)
    z_max: float = Field(default=0.0, ge=0, le=1)
    sigma_hit_m: float = Field(default=0.1, gt=0)
    range_max_m: float = Field(default=30.0, gt=0)
    tempering: float = Field(default=1.0, gt=0, le=1)

    @model_validator(mode="after")
    def _shares_sum_to_one(self) -> LikelihoodField:
        if abs(self.z_hit + self.z_rand + self.z_max - 1) > 1e-9:
            raise ValueError("z_hit, z_rand and z_max must sum to 1")
        return self

    def log_likelihoods(self, distances: NDArray[np.float32]) -> NDArray[np.float32]:
        """Log likelihood of a beam for the distance (...) in m of its end to the nearest obstacle, before tempering."""
        peak = np.float32(self.z_hit / (math.sqrt(math.tau) * self.sigma_hit_m))
        exponent, uniform = np.float32(-0.5 / self.sigma_hit_m**2), np.float32(self.z_rand / self.range_max_m)
        log_density: NDArray[np.float32] = np.log(peak * np.exp(exponent * np.square(distances)) + uniform)
        return log_density

    def __call__(self, beams: Beams) -> ScanLikelihood:
        """Condition on the beams of one scan."""
        ends = beams.ends

        def log_likelihood(maps: DistanceMaps, rows: Rows, poses: FloatArray) -> FloatArray:
            log_likelihood = self.log_likelihoods(maps.distances(rows, poses, ends))
            return np.asarray(self.tempering * log_likelihood.sum(axis=1, dtype=np.float64))

        return log_likelihood
