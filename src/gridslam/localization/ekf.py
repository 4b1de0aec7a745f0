"""EKF localization: one Gaussian over the robot's pose, in a map of landmarks that is known.

It tracks p(x_t | z_1:t, u_1:t, m). A Gaussian has one peak, so it needs to know roughly where the robot begins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import freeze
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap_headings
from gridslam.models.association import Association, KnownCorrespondence
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, RangeBearing
from gridslam.models.systematic_errors import ERRORS, NO_ERRORS, SystematicErrors, linearize
from gridslam.particles.initial import repeat_pose
from gridslam.types import FloatArray, IntArray, MotionSampler


@final
@dataclass(frozen=True, slots=True, eq=False)
class KnownLandmarks:
    """A map of point landmarks, regarded as exact.

    Attributes
    ----------
    names : (M,) int64
        Signatures, each once.
    positions : (M, 2) float64, m
        Map frame.
    """

    names: IntArray
    positions: FloatArray

    def __repr__(self) -> str:
        """Return one line."""
        return f"KnownLandmarks({len(self.names)} landmarks)"

    @classmethod
    def of(cls, names: ArrayLike, positions: ArrayLike) -> KnownLandmarks:
        """Validate and copy; ArgumentError for wrong shapes, no landmark, a name twice, a value that is not finite."""
        places = freeze(positions, np.float64, (None, 2), "positions")
        signatures = freeze(names, np.int64, (len(places),), "names")
        if not len(places) or not np.isfinite(places).all():
            raise ArgumentError("positions", "at least one landmark, at finite places", places.tolist())
        if len(np.unique(signatures)) < len(signatures):
            raise ArgumentError("names", "each landmark once", signatures.tolist())
        return cls(signatures, places)


@final
@dataclass(frozen=True, slots=True, eq=False)
class PoseGaussian:
    """The belief: a Gaussian over the pose and the systematic errors.

    Attributes
    ----------
    mean, whole_covariance : (8,), (8, 8) float64
        Of the pose [x m, y m, theta rad], map frame, and the systematic errors.
    """

    mean: FloatArray
    whole_covariance: FloatArray

    @property
    def pose(self) -> FloatArray:
        """Mean pose (3,)."""
        return self.mean[:3]

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of the pose."""
        return self.whole_covariance[:3, :3]


@final
@dataclass(frozen=True, slots=True, eq=False)
class EkfLocalizationReport:
    """Report of one step.

    Attributes
    ----------
    pose, covariance : (3,), (3, 3) float64
        The belief after the step.
    landmarks : (K,) int64
        Name of the landmark associated with each observation. `NEW` if it is none of the map, and `AMBIGUOUS` if it is
        ambiguous or an outlier: these are not used.
    log_likelihood : float, nats
        log p(z_t | z_1:t-1, u_1:t, m) of the accepted observations; 0 if there are none.
    """

    pose: FloatArray
    covariance: FloatArray
    landmarks: IntArray
    log_likelihood: float


@final
@dataclass(frozen=True)
class EkfLocalization:
    """The filter; a belief goes into `step`, and another one comes out.

    Attributes
    ----------
    landmarks : KnownLandmarks
        The map m.
    sensor : LandmarkModel
        p(z | x, m) of one landmark.
    association : Association
        `KnownCorrespondence` if the observations contain the correspondences, `MaximumLikelihood` otherwise. Both gate
        by the Mahalanobis distance of an observation from its prediction.
    bias : SystematicErrors
        Systematic errors of odometry and sensor, which are part of what is estimated.

    References
    ----------
    Probabilistic Robotics, Tables 7.2 (known correspondences) and 7.3 (unknown; here no landmark is associated
    twice in one step). The tables correct by one observation after the other; here all observations of a step are used
    at once: the same for a linear model, and otherwise independent of their order.

    Y. Bar-Shalom and T. Fortmann, Tracking and Data Association (1988), for unknown correspondences.
    """

    landmarks: KnownLandmarks
    sensor: LandmarkModel = field(default_factory=RangeBearing)
    association: Association = field(default_factory=KnownCorrespondence)
    bias: SystematicErrors = NO_ERRORS

    def init(self, pose: ArrayLike, covariance: ArrayLike) -> PoseGaussian:
        """Begin near a pose (3,), with a covariance (3, 3).

        Raises ArgumentError for a pose that is not finite, or a matrix that is no covariance.
        """
        mean = repeat_pose(1, pose)[0]
        spread = freeze(covariance, np.float64, (3, 3), "covariance")
        if not np.isfinite(spread).all() or not np.allclose(spread, spread.T) or np.linalg.eigvalsh(spread)[0] < 0:
            raise ArgumentError("covariance", "a symmetric matrix without negative eigenvalue", spread.tolist())
        whole = np.zeros((3 + ERRORS, 3 + ERRORS))
        whole[:3, :3] = spread
        whole[3:, 3:] = self.bias.covariance()
        return PoseGaussian(np.append(mean, np.zeros(ERRORS)), whole)

    def step(
        self, belief: PoseGaussian, motion: MotionSampler, observations: LandmarkObservations
    ) -> tuple[PoseGaussian, EkfLocalizationReport]:
        """Take one step.

        Parameters
        ----------
        belief : PoseGaussian
        motion : MotionSampler
            The motion model, conditioned on u_t.
        observations : LandmarkObservations
            z_t, with c_t where the association needs it; perhaps none.

        Raises
        ------
        ArgumentError
            The association needs correspondences that the observations do not contain.
        """
        moved, G, R = self.bias.predict(motion, belief.mean)  # Table 7.2, lines 2 to 7
        belief = PoseGaussian(moved, G @ belief.whole_covariance @ G.T + R)
        if not len(observations):
            return belief, EkfLocalizationReport(belief.pose, belief.covariance, np.empty(0, np.int64), 0.0)
        noise = self.sensor.noise(observations)
        places, values, spread = self._correspondences(belief, observations, noise)
        seen = np.flatnonzero(places >= 0)
        belief, log_likelihood = self._correct(belief, places[seen], values[seen], noise[seen], spread[seen])
        reported = np.where(places >= 0, self.landmarks.names[places], places)
        return belief, EkfLocalizationReport(belief.pose, belief.covariance, reported, log_likelihood)

    def _correspondences(
        self, belief: PoseGaussian, observations: LandmarkObservations, noise: FloatArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Table 7.3, lines 9 to 15: the index (K,) of each observation's landmark in the map.

        Where it is not known whose an observation is, its innovation is the mean over the landmarks by their posterior
        probabilities, and their spread about it is noise (probabilistic data association). So it also returns the
        observations (K, 2) of these landmarks that have such innovations, and the covariances (K, 2, 2) of that noise.
        """
        predicted, H = linearize(self.sensor, belief.mean, self.landmarks.positions)
        innovations = self.sensor.residual(observations.values[:, None], predicted)
        S = H @ belief.whole_covariance @ H.swapaxes(-1, -2) + noise[:, None]
        distances = np.einsum("kmi,kmij,kmj->km", innovations, np.linalg.inv(S), innovations)
        log_dets = np.linalg.slogdet(S)[1]
        places = self.association(observations, self.landmarks.names, distances, log_dets)
        if self.association.uses_signatures:
            return places, observations.values, np.zeros_like(noise)
        costs = distances + log_dets
        probabilities = np.exp(0.5 * (costs.min(axis=1, keepdims=True) - costs))
        probabilities /= probabilities.sum(axis=1, keepdims=True)
        mean = np.einsum("km,kmi->ki", probabilities, innovations)
        away = innovations - mean[:, None]
        spread = np.einsum("km,kmi,kmj->kij", probabilities, away, away)
        of_place = innovations[np.arange(len(places)), np.maximum(places, 0)]
        return places, observations.values + mean - of_place, spread

    def _correct(
        self, belief: PoseGaussian, places: IntArray, measured: FloatArray, noise: FloatArray, spread: FloatArray
    ) -> tuple[PoseGaussian, float]:
        """Table 7.2, lines 11 to 21, for K observations: P - K S K' = P - W' W with W = L^-1 H P, S = L L'."""
        if not (count := len(places)):
            return belief, 0.0
        predicted, H = linearize(self.sensor, belief.mean, self.landmarks.positions[places])
        residuals = self.sensor.residual(measured, predicted).ravel()
        P = belief.whole_covariance
        H = H.reshape(-1, len(P))
        S = (H @ P @ H.T).reshape(count, 2, count, 2)
        S[np.arange(count), :, np.arange(count)] += noise + spread
        L = np.linalg.cholesky(S.reshape(2 * count, 2 * count))
        W = np.linalg.solve(L, H @ P)
        whitened = np.linalg.solve(L, residuals)
        mean = wrap_headings(belief.mean + whitened @ W)
        log_likelihood = -0.5 * float(whitened @ whitened) - count * math.log(2 * math.pi)
        log_likelihood -= float(np.log(np.diagonal(L)).sum())
        return PoseGaussian(mean, P - W.T @ W), log_likelihood
