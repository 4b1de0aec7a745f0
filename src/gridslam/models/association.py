"""Data association of landmark observations."""

from __future__ import annotations

import math
from typing import ClassVar, TypeAlias, final

import numpy as np
from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass as parameters

from gridslam.errors import ArgumentError
from gridslam.models.landmark_observations import LandmarkObservations
from gridslam.models.parameters import STRICT
from gridslam.types import FloatArray, IntArray

__all__ = ["AMBIGUOUS", "NEW", "Association", "KnownCorrespondence", "MaximumLikelihood", "signatures"]

NEW, AMBIGUOUS = -1, -2
"""Instead of a landmark index: a new landmark, or an ambiguous observation."""


@final
@parameters(frozen=True, config=STRICT)
class KnownCorrespondence:
    """Known correspondences, with an outlier gate.

    Distances are squared Mahalanobis distances between observations and predictions, with two degrees of freedom.

    Parameters
    ----------
    gate : float
        Up to this distance, 20 standard deviations. A true one seldom exceeds 4; but odometry has biases that no noise
        model knows, and when the EKF closes Victoria Park's first loop it is 13 off. A misread barcode is off by 50.
    """

    gate: float = Field(default=400.0, gt=0)
    uses_signatures: ClassVar[bool] = True

    @property
    def outlier_distance(self) -> float:
        """Squared Mahalanobis distance assigned to an outlier."""
        return self.gate

    def __call__(
        self, observations: LandmarkObservations, names: IntArray, distances: FloatArray, log_dets: FloatArray
    ) -> IntArray:
        """Indices (K,) of the observed landmarks among M, or `NEW`, or `AMBIGUOUS`.

        Parameters
        ----------
        observations : LandmarkObservations
            K of them.
        names : (M,) int64
            Names of the landmarks.
        distances, log_dets : (K, M) float64
            Between observations and predictions, and log determinants of the innovation covariances:
            -2 log p is the sum of both and a constant.

        Raises
        ------
        ArgumentError
            The observations have no correspondences.
        """
        same = signatures(observations)[:, None] == names
        places = np.where(distances <= self.gate, np.arange(len(names)), AMBIGUOUS)
        return np.where(same.any(axis=1), places.sum(axis=1, where=same), NEW)


@final
@parameters(frozen=True, config=STRICT)
class MaximumLikelihood:
    """Maximum likelihood correspondence with a gate; each landmark is matched at most once per step.

    Distances are as for `KnownCorrespondence`.

    Parameters
    ----------
    match_gate : float
        Gate of the association; 9.2 holds for 99 % of the true pairs.
    new_gate : float
        From this distance on to all landmarks it is of another one. The book has one threshold; between the two
        nothing is learned, so that an outlier neither moves a landmark nor doubles it.

    Source: Probabilistic Robotics, Table 10.2, lines 9 to 16, and 10.3.3.
    """

    match_gate: float = Field(default=9.2, gt=0)
    new_gate: float = Field(default=25.0, gt=0)
    uses_signatures: ClassVar[bool] = False

    @model_validator(mode="after")
    def _ordered(self) -> MaximumLikelihood:
        if self.match_gate > self.new_gate:
            raise ValueError("expected match_gate <= new_gate")
        return self

    @property
    def outlier_distance(self) -> float:
        """Squared Mahalanobis distance assigned to a new landmark: p_0 of Table 13.2."""
        return self.new_gate

    def __call__(
        self, observations: LandmarkObservations, names: IntArray, distances: FloatArray, log_dets: FloatArray
    ) -> IntArray:
        """Indices (K,), as for `KnownCorrespondence`, estimated from the distances."""
        costs = np.where(distances <= self.match_gate, distances + log_dets, math.inf)
        chosen, free = np.full(len(costs), NEW), np.ones(len(names), np.bool_)
        while np.isfinite(costs).any():  # the surest pair first
            observation, landmark = np.unravel_index(costs.argmin(), costs.shape)
            chosen[observation], free[landmark] = landmark, False
            costs[observation], costs[:, landmark] = math.inf, math.inf
        near = (distances[:, free] <= self.new_gate).any(axis=1)
        chosen[(chosen == NEW) & near] = AMBIGUOUS
        return chosen


Association: TypeAlias = KnownCorrespondence | MaximumLikelihood


def signatures(observations: LandmarkObservations) -> IntArray:
    """Return the signatures (K,) of observations; raises ArgumentError if there are none."""
    if observations.landmarks is None:
        raise ArgumentError("observations", "known correspondences, or an association that estimates them", "neither")
    return observations.landmarks
