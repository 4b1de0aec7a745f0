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
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import lever_arm_jacobian
from gridslam.models.association import Association, KnownCorrespondence
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, RangeBearing
from gridslam.types import FloatArray, IntArray, MotionSampler

__all__ = ["EkfLocalization", "EkfLocalizationReport", "KnownLandmarks", "PoseGaussian"]


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
    """The belief: mean pose (3,), map frame, and its covariance (3, 3) by x, y in m and theta in rad."""

    pose: FloatArray
    covariance: FloatArray


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

    References
    ----------
    Probabilistic Robotics, Tables 7.2 (known correspondences) and 7.3 (unknown; here no landmark is associated
    twice in one step). The tables correct by one observation after the other; here all observations of a step are used
    at once: the same for a linear model, and otherwise independent of their order.
    """

    landmarks: KnownLandmarks
    sensor: LandmarkModel = field(default_factory=RangeBearing)
    association: Association = field(default_factory=KnownCorrespondence)

    def init(self, pose: ArrayLike, covariance: ArrayLike) -> PoseGaussian:
        """Begin near a pose (3,), with a covariance (3, 3).

        Raises ArgumentError for a pose that is not finite, or a matrix that is no covariance.
        """
        mean = freeze(pose, np.float64, (3,), "pose")
        spread = freeze(covariance, np.float64, (3, 3), "covariance")
        if not np.isfinite(mean).all():
            raise ArgumentError("pose", "finite x, y, theta", mean.tolist())
        if not np.isfinite(spread).all() or not np.allclose(spread, spread.T) or np.linalg.eigvalsh(spread)[0] < 0:
            raise ArgumentError("covariance", "a symmetric matrix without negative eigenvalue", spread.tolist())
        return PoseGaussian(np.array([mean[0], mean[1], wrap(float(mean[2]))]), spread)

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
        belief = self._predict(belief, motion)
        if not len(observations):
            return belief, EkfLocalizationReport(belief.pose, belief.covariance, np.empty(0, np.int64), 0.0)
        noise = self.sensor.noise(observations)
        places = self._correspondences(belief, observations, noise)
        seen = np.flatnonzero(places >= 0)
        belief, log_likelihood = self._correct(belief, places[seen], observations.values[seen], noise[seen])
        reported = np.where(places >= 0, self.landmarks.names[places], places)
        return belief, EkfLocalizationReport(belief.pose, belief.covariance, reported, log_likelihood)

    def _predict(self, belief: PoseGaussian, motion: MotionSampler) -> PoseGaussian:
        """Table 7.2, lines 2 to 7."""
        (pose,), (motion_noise,) = motion.moments(belief.pose[None])
        G = lever_arm_jacobian(belief.pose, pose)
        return PoseGaussian(pose, G @ belief.covariance @ G.T + motion_noise)

    def _correspondences(self, belief: PoseGaussian, observations: LandmarkObservations, noise: FloatArray) -> IntArray:
        """Table 7.3, lines 9 to 15: the index of each observation's landmark in the map."""
        predicted, H, _ = self.sensor.linearize(belief.pose, self.landmarks.positions)
        residuals = self.sensor.residual(observations.values[:, None], predicted)
        S = H @ belief.covariance @ H.swapaxes(1, 2) + noise[:, None]
        distances = np.einsum("kmi,kmij,kmj->km", residuals, np.linalg.inv(S), residuals)
        return self.association(observations, self.landmarks.names, distances, np.linalg.slogdet(S)[1])

    def _correct(
        self, belief: PoseGaussian, places: IntArray, measured: FloatArray, noise: FloatArray
    ) -> tuple[PoseGaussian, float]:
        """Table 7.2, lines 11 to 21, for K observations: P - K S K' = P - W' W with W = L^-1 H P, S = L L'."""
        if not (count := len(places)):
            return belief, 0.0
        predicted, H, _ = self.sensor.linearize(belief.pose, self.landmarks.positions[places])
        residuals = self.sensor.residual(measured, predicted).ravel()
        H, P = H.reshape(-1, 3), belief.covariance
        S = (H @ P @ H.T).reshape(count, 2, count, 2)
        S[np.arange(count), :, np.arange(count)] += noise
        L = np.linalg.cholesky(S.reshape(2 * count, 2 * count))
        W = np.linalg.solve(L, H @ P)
        whitened = np.linalg.solve(L, residuals)
        pose = belief.pose + whitened @ W
        pose[2] = wrap(float(pose[2]))
        log_likelihood = -0.5 * float(whitened @ whitened) - count * math.log(2 * math.pi)
        return PoseGaussian(pose, P - W.T @ W), log_likelihood - float(np.log(np.diagonal(L)).sum())
