"""Data association of landmark observations, and whether a landmark exists at all."""

from __future__ import annotations

import math
from typing import ClassVar, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.models.landmark import LandmarkObservations, offset
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, IntArray

NEW = -1
"""Instead of a landmark index: a new landmark."""

AMBIGUOUS = -2
"""Instead of a landmark index: an ambiguous observation."""


@final
@parameters(frozen=True)
class KnownCorrespondence:
    """Known correspondences, with an outlier gate.

    Distances are squared Mahalanobis distances between observations and predictions, with two degrees of freedom.

    Parameters
    ----------
    gate : float
        Up to this distance, 20 standard deviations. A true one seldom exceeds 4; but odometry has biases that no noise
        model knows, and when the EKF closes Victoria Park's first loop it is 13 off. A misread barcode is off by 50.
    """

    gate: float = bounded(400.0, gt=0)
    uses_signatures: ClassVar[bool] = True

    @property
    def outlier_distance(self) -> float:
        """Squared Mahalanobis distance assigned to an outlier."""
        return self.gate

    def __call__(
        self, observations: LandmarkObservations, names: IntArray, distances: FloatArray, log_dets: FloatArray
    ) -> IntArray:
        """Return indices (K,) of the observed landmarks among M, or `NEW`, or `AMBIGUOUS`.

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
@parameters(frozen=True)
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

    References
    ----------
    Probabilistic Robotics, Table 10.2, lines 9 to 16, and 10.3.3.
    """

    match_gate: float = bounded(9.2, gt=0)
    new_gate: float = bounded(25.0, gt=0)
    uses_signatures: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        if self.match_gate > self.new_gate:
            raise ValueError("expected match_gate <= new_gate")

    @property
    def outlier_distance(self) -> float:
        """Squared Mahalanobis distance assigned to a new landmark: p_0 of Table 13.2."""
        return self.new_gate

    def __call__(
        self, observations: LandmarkObservations, names: IntArray, distances: FloatArray, log_dets: FloatArray
    ) -> IntArray:
        """Return indices (K,), as for `KnownCorrespondence`, estimated from the distances."""
        costs = np.where(distances <= self.match_gate, distances + log_dets, math.inf)
        chosen = np.full(len(costs), NEW)
        free = np.ones(len(names), np.bool_)
        while np.isfinite(costs).any():  # the surest pair first
            observation, landmark = np.unravel_index(costs.argmin(), costs.shape)
            chosen[observation] = landmark
            free[landmark] = False
            costs[observation] = costs[:, landmark] = math.inf
        near = (distances[:, free] <= self.new_gate).any(axis=1)
        chosen[(chosen == NEW) & near] = AMBIGUOUS
        return chosen


Association: TypeAlias = KnownCorrespondence | MaximumLikelihood


def signatures(observations: LandmarkObservations) -> IntArray:
    """Return the signatures (K,) of observations; raises ArgumentError if there are none."""
    if observations.landmarks is None:
        raise ArgumentError("observations", "known correspondences, or an association that estimates them", "neither")
    return observations.landmarks


@final
@parameters(frozen=True)
class LandmarkExistence:
    """Log odds that a landmark exists, by a binary Bayes filter.

    A landmark begins with the evidence of having been seen once. It is provisional until its log odds reach
    `log_odds_confirmed`, and dropped where they fall below 0. They saturate, so that what a wrong correspondence made
    can fade. In EKF SLAM it is provisional again when they fall below `log_odds_confirmed`; in FastSLAM it stays
    confirmed until it is dropped, for what is hidden for a while is still there, and a wrong one ends with the particle
    that made it.

    Parameters
    ----------
    detection : float, (0, 1)
        Probability that a landmark in view is seen; MRCLAM's cameras see a third of the barcodes in view.
    false_alarm : float, (0, detection)
        Probability that, where there is none, something is seen and taken for it.
    log_odds_confirmed : float, nats, > 0
        Log-odds after three observations, with the defaults.
    log_odds_max : float, nats, >= log_odds_confirmed
        Where the log odds saturate: so far above `log_odds_confirmed` that what is hidden for some seconds stays.
    range_min_m, range_max_m : float, m
        Between which distances landmarks are in view; well within what the sensor reaches.
    half_angle_rad : float, rad, (0, pi]
        Up to which bearing, to both sides.

    References
    ----------
    Montemerlo et al., FastSLAM 2.0 (IJCAI 2003), section 4; Probabilistic Robotics, 13.6 and Table 13.2.
    """

    detection: float = bounded(0.3, gt=0, lt=1)
    false_alarm: float = bounded(0.03, gt=0, lt=1)
    log_odds_confirmed: float = bounded(6.0, gt=0)
    log_odds_max: float = bounded(12.0, gt=0)
    range_min_m: float = bounded(1.0, ge=0)
    range_max_m: float = bounded(5.0, gt=0)
    half_angle_rad: float = bounded(0.4, gt=0, le=math.pi)

    def __post_init__(self) -> None:
        """Refuse parameters that do not go together."""
        if not (self.false_alarm < self.detection and self.log_odds_confirmed <= self.log_odds_max):
            raise ValueError("expected false_alarm < detection and log_odds_confirmed <= log_odds_max")

    @property
    def log_odds_detected(self) -> float:
        """Evidence of an observation, nats."""
        return math.log(self.detection / self.false_alarm)

    @property
    def log_odds_missed(self) -> float:
        """Log-odds of a missed detection in view, nats; below 0."""
        return math.log((1 - self.detection) / (1 - self.false_alarm))

    def __call__(
        self, evidence: FloatArray, seen: NDArray[np.bool_], poses: FloatArray, landmarks: FloatArray
    ) -> FloatArray:
        """Update the log odds (...) of landmarks (..., 2) that were seen (...) or not from poses (..., 3)."""
        x, y = offset(poses, landmarks)
        square = x * x + y * y
        near = (square > self.range_min_m**2) & (square < self.range_max_m**2)
        bearing = wrap(np.arctan2(y, x) - poses[..., 2])
        missed = ~seen & near & (np.abs(bearing) < self.half_angle_rad)
        added = evidence + self.log_odds_detected * seen + self.log_odds_missed * missed
        return np.asarray(np.minimum(added, self.log_odds_max))
