"""Data association: which landmark each sighting is of, where nothing tells it."""

from __future__ import annotations

import math
from typing import ClassVar, TypeAlias, final

import numpy as np
from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass as parameters

from gridslam.errors import ArgumentError
from gridslam.models.parameters import STRICT
from gridslam.models.sightings import Sightings
from gridslam.types import FloatArray, IntArray

__all__ = ["AMBIGUOUS", "NEW", "Association", "MaximumLikelihood", "Told", "signatures"]

NEW, AMBIGUOUS = -1, -2
"""Instead of a landmark: the sighting is of none that is known, or it cannot be told whether it is."""


@final
@parameters(frozen=True, config=STRICT)
class Told:
    """The correspondence is what the sighting tells, as far as it can be believed.

    Distances are squared Mahalanobis distances of a sighting from what is predicted, with two degrees of freedom.

    Parameters
    ----------
    believed : float
        Up to this distance, 20 standard deviations. A true one seldom exceeds 4; but odometry has biases that no noise
        model knows, and when the EKF closes Victoria Park's first loop it is 13 off. A misread barcode is off by 50.
    """

    believed: float = Field(default=400.0, gt=0)
    told: ClassVar[bool] = True

    @property
    def strange(self) -> float:
        """The distance whose likelihood counts for a sighting that is not believed."""
        return self.believed

    def __call__(
        self, sightings: Sightings, names: IntArray, distances: FloatArray, log_dets: FloatArray
    ) -> IntArray:
        """Places (K,) of the sightings' landmarks among M, or `NEW`, or `AMBIGUOUS`.

        Parameters
        ----------
        sightings : Sightings
            K of them.
        names : (M,) int64
            Names of the landmarks.
        distances, log_dets : (K, M) float64
            Of the sightings from what is predicted of the landmarks, and log determinants of their covariances:
            -2 log p is the sum of both and a constant.

        Raises
        ------
        ArgumentError
            The sightings do not tell their landmarks.
        """
        same = signatures(sightings)[:, None] == names
        places = np.where(distances <= self.believed, np.arange(len(names)), AMBIGUOUS)
        return np.where(same.any(axis=1), places.sum(axis=1, where=same), NEW)


@final
@parameters(frozen=True, config=STRICT)
class MaximumLikelihood:
    """The likeliest correspondence, where it is likely enough; each landmark is seen at most once at a time.

    Distances are as for `Told`.

    Parameters
    ----------
    same : float
        Up to this distance a sighting may be of the landmark; 9.2 holds for 99 % of the true ones.
    other : float
        From this distance on to all landmarks it is of another one. The book has one threshold; between the two
        nothing is learned, so that an outlier neither moves a landmark nor doubles it.

    Source: Probabilistic Robotics, Table 10.2, lines 9 to 16, and 10.3.3.
    """

    same: float = Field(default=9.2, gt=0)
    other: float = Field(default=25.0, gt=0)
    told: ClassVar[bool] = False

    @model_validator(mode="after")
    def _ordered(self) -> MaximumLikelihood:
        if self.same > self.other:
            raise ValueError("expected same <= other")
        return self

    @property
    def strange(self) -> float:
        """The distance whose likelihood counts for a sighting of no known landmark: p_0 of Table 13.2."""
        return self.other

    def __call__(
        self, sightings: Sightings, names: IntArray, distances: FloatArray, log_dets: FloatArray
    ) -> IntArray:
        """Places (K,), as for `Told`, whatever the sightings tell."""
        costs = np.where(distances <= self.same, distances + log_dets, math.inf)
        chosen, free = np.full(len(costs), NEW), np.ones(len(names), np.bool_)
        while np.isfinite(costs).any():  # the surest pair first
            sighting, landmark = np.unravel_index(costs.argmin(), costs.shape)
            chosen[sighting], free[landmark] = landmark, False
            costs[sighting], costs[:, landmark] = math.inf, math.inf
        near = (distances[:, free] <= self.other).any(axis=1)
        chosen[(chosen == NEW) & near] = AMBIGUOUS
        return chosen


Association: TypeAlias = Told | MaximumLikelihood


def signatures(sightings: Sightings) -> IntArray:
    """Return the signatures (K,) that sightings tell; raises ArgumentError where they tell none."""
    if sightings.landmarks is None:
        raise ArgumentError("sightings", "landmarks told, or an association that finds them", "neither")
    return sightings.landmarks
