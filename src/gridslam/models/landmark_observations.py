"""Steps of a landmark log: motion and landmark observations."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import freeze
from gridslam.errors import ArgumentError
from gridslam.models.motion import GaussianIncrement
from gridslam.types import FloatArray, IntArray, MotionModel, MotionSampler

__all__ = ["NO_OBSERVATIONS", "LandmarkObservations", "LandmarkStep", "ObservationKind"]


class ObservationKind(Enum):
    """Type of the two numbers of an observation."""

    RANGE_BEARING = "range (m) and bearing (rad)"
    DEPTH_BEARING = "depth along the optical axis (m) and bearing (rad)"
    POSITION = "x and y in the robot's frame (m)"


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkObservations:
    """Landmark observations at one time: z_t, and c_t if known.

    Attributes
    ----------
    values : (K, 2) float64
        Measurements, of the type given by `ObservationKind`, in the robot's frame.
    landmarks : (K,) int64 or None
        The signature of each, by which it is known again; None where nothing is known. No two are the same.
    covariances : (K, 2, 2) float64 or None
        Covariance of each measurement, if the log contains them; they take precedence over the measurement model's.
    """

    values: FloatArray
    landmarks: IntArray | None = None
    covariances: FloatArray | None = None

    @classmethod
    def of(
        cls, values: ArrayLike, landmarks: ArrayLike | None = None, covariances: ArrayLike | None = None
    ) -> LandmarkObservations:
        """Validate and copy; raises ArgumentError for a wrong shape, a value that is not finite, a landmark twice."""
        z = freeze(values, np.float64, (None, 2), "values")
        count = len(z)
        names = None if landmarks is None else freeze(landmarks, np.int64, (count,), "landmarks")
        spread = None if covariances is None else freeze(covariances, np.float64, (count, 2, 2), "covariances")
        if not np.isfinite(z).all() or (spread is not None and not np.isfinite(spread).all()):
            raise ArgumentError("observations", "finite numbers", "a value that is not")
        if names is not None and len(np.unique(names)) < count:
            raise ArgumentError("landmarks", "each landmark once at a time", names.tolist())
        return cls(z, names, spread)

    def __len__(self) -> int:
        """Return the number K of observations."""
        return len(self.values)

    def drop_correspondences(self) -> LandmarkObservations:
        """Return the same observations without correspondences."""
        return LandmarkObservations(self.values, None, self.covariances)


NO_OBSERVATIONS = LandmarkObservations.of(np.empty((0, 2)), np.empty(0, np.int64))
"""The observations of a step at which no landmark was observed."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkStep:
    """One step of a log: u_t and z_t.

    Attributes
    ----------
    stamp_ns : int
        Of the observations, or of the end of the motion without observations.
    increment : (3,) float64
        The robot now, seen from where it was at the step before, by its odometry [x m, y m, theta rad].
    covariance : (3, 3) float64 or None
        Of the increment, in the frame of the last pose, if the log contains it; None leaves it to the motion model.
    observations : LandmarkObservations
        Landmarks seen now; perhaps none.
    """

    stamp_ns: int
    increment: FloatArray
    covariance: FloatArray | None
    observations: LandmarkObservations

    def motion(self, model: MotionModel) -> MotionSampler:
        """p(x_t | u_t, x_{t-1}): with the increment's own covariance if the log contains one, else by the model."""
        if self.covariance is None:
            return model(self.increment)
        variances, axes = np.linalg.eigh(self.covariance)
        root = axes * np.sqrt(np.maximum(variances, 0.0))

        def to_increment(noise: FloatArray) -> FloatArray:
            return np.asarray(self.increment + noise @ root.T)

        return GaussianIncrement(np.zeros(3), np.ones(3), self.increment, root, to_increment)
