"""The state of EKF SLAM: one Gaussian over the pose and all landmarks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ConsumedStateError
from gridslam.particles.initial import repeat_pose
from gridslam.slam.landmarks.report import LandmarkMap
from gridslam.types import FloatArray, IntArray

__all__ = ["EkfSlamState"]


@final
@dataclass(slots=True, eq=False)
class EkfSlamState:
    """Everything that the filter knows between two steps; it has one owner, who changes it.

    Attributes
    ----------
    mean, covariance : (3 + B + 2 M,), (3 + B + 2 M, 3 + B + 2 M) float64
        Of [x, y, theta, b_1, ..., m_1x, m_1y, m_2x, ...], in m and rad, map frame.
    names : (M,) int64
        Signatures of the landmarks, or numbers in the order of first sight.
    evidence : (M,) float64, nats
        Log odds that each exists; infinite where its signature is known.
    observations : (M,) int64
        How often each was seen.
    next_name : int
        Number of the next landmark without a signature.
    biases : int
        The number B of the odometry's errors that are learned.
    """

    mean: FloatArray
    covariance: FloatArray
    names: IntArray
    evidence: FloatArray
    observations: IntArray
    next_name: int = 0
    biases: int = 0
    consumed: bool = False

    @classmethod
    def at(cls, pose: ArrayLike, bias: FloatArray) -> EkfSlamState:
        """Begin at a pose (3,) that is exact, with errors of the odometry of covariance (B, B).

        Raises ArgumentError where the pose is none.
        """
        nothing, size = np.empty(0, np.int64), 3 + len(bias)
        mean, covariance = np.zeros(size), np.zeros((size, size))
        mean[:3], covariance[3:, 3:] = repeat_pose(1, pose)[0], bias
        return cls(mean, covariance, nothing, np.empty(0), nothing, biases=len(bias))

    @property
    def first(self) -> int:
        """Row of the first landmark: 3 + B."""
        return 3 + self.biases

    @property
    def pose(self) -> FloatArray:
        """Mean pose (3,)."""
        return self.mean[:3]

    @property
    def pose_covariance(self) -> FloatArray:
        """Covariance (3, 3) of the pose."""
        return self.covariance[:3, :3]

    @property
    def positions(self) -> FloatArray:
        """Mean positions (M, 2) of the landmarks."""
        return self.mean[self.first :].reshape(-1, 2)

    @property
    def position_covariances(self) -> FloatArray:
        """Covariance (M, 2, 2) of each landmark."""
        count = np.arange(len(self.names))
        of_landmarks = self.covariance[self.first :, self.first :].reshape(len(count), 2, len(count), 2)
        blocks: FloatArray = of_landmarks[count, :, count]
        return blocks

    def landmark_map(self, least_evidence: float) -> LandmarkMap:
        """Return the landmarks whose log odds are at least so great."""
        kept = self.evidence >= least_evidence
        covariances = self.position_covariances[kept]
        return LandmarkMap(self.names[kept], self.positions[kept], covariances, self.observations[kept])

    def append(self, name: int, position: FloatArray, with_others: FloatArray, own: FloatArray) -> None:
        """Add a landmark at the end.

        Parameters
        ----------
        name : int
        position : (2,) float64
        with_others : (2, n) float64
            Its covariance with all that is in the state.
        own : (2, 2) float64
            Its own covariance.
        """
        self.mean = np.concatenate([self.mean, position])
        self.covariance = np.block([[self.covariance, with_others.T], [with_others, own]])
        self.names = np.append(self.names, name)
        self.evidence, self.observations = np.append(self.evidence, 0.0), np.append(self.observations, 0)

    def keep(self, kept: NDArray[np.bool_]) -> None:
        """Forget all landmarks but those `kept` (M,)."""
        rows = np.flatnonzero(np.concatenate([np.ones(self.first, np.bool_), np.repeat(kept, 2)]))
        self.mean, self.covariance = self.mean[rows], self.covariance[np.ix_(rows, rows)]
        self.names, self.evidence, self.observations = self.names[kept], self.evidence[kept], self.observations[kept]

    def take(self) -> EkfSlamState:
        """Hand the contents over to a new owner; this one raises ConsumedStateError from now on."""
        self._check()
        self.consumed = True
        return replace(self, consumed=False)

    def snapshot(self) -> EkfSlamState:
        """Return an independent copy for later."""
        self._check()
        return EkfSlamState(
            self.mean.copy(), self.covariance.copy(), self.names.copy(), self.evidence.copy(), self.observations.copy(),
            next_name=self.next_name, biases=self.biases,
        )  # fmt: skip

    def _check(self) -> None:
        if self.consumed:
            raise ConsumedStateError
