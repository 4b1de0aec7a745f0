"""Report of one step of a landmark filter, and the final landmark map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from gridslam.types import FloatArray, IntArray


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkReport:
    """Report of one filter step.

    Attributes
    ----------
    pose, covariance : (3,), (3, 3) float64
        Of the robot, map frame: of the EKF, or of the best particle and of all particles about it.
    landmarks : (K,) int64
        Name of the landmark associated with each observation (see `LandmarkMap`), also of a new one; `AMBIGUOUS` for an
        unused observation. With particles it is the association of the best one.
    n_eff : float
        Effective sample size before resampling; 1 for the EKF.
    parents : (N,) int64 or None
        For each particle after the step the one that it continues; None where nothing was resampled.
    """

    pose: FloatArray
    covariance: FloatArray
    landmarks: IntArray
    n_eff: float = 1.0
    parents: IntArray | None = None


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkMap:
    """Estimated landmarks.

    Attributes
    ----------
    names : (M,) int64
        Their signatures where correspondences are known, else numbers in the order of first sight.
    positions : (M, 2) float64, m
        Map frame.
    covariances : (M, 2, 2) float64, m^2
        Of each position by itself.
    observations : (M,) int64
        Number of observations of each.
    """

    names: IntArray
    positions: FloatArray
    covariances: FloatArray
    observations: IntArray

    def __len__(self) -> int:
        """Return the number M of landmarks."""
        return len(self.names)

    def __repr__(self) -> str:
        """Return one line."""
        return f"LandmarkMap({len(self)} landmarks, {int(self.observations.sum())} observations)"
