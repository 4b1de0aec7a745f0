"""What one step of a landmark filter tells, and the landmarks as they are told at the end."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from gridslam.types import FloatArray, IntArray

__all__ = ["LandmarkMap", "LandmarkReport"]


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkReport:
    """What one step of a filter tells its observers.

    Attributes
    ----------
    pose, covariance : (3,), (3, 3) float64
        Of the robot, map frame: of the EKF, or of the best particle and of all particles about it.
    landmarks : (K,) int64
        Which landmark each sighting was taken for, by its name (see `LandmarkMap`), that of a new one, too; `AMBIGUOUS`
        for a sighting of which nothing was learned. With particles it is what the best one says.
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
    """Landmarks, as an algorithm tells them at the end.

    Attributes
    ----------
    names : (M,) int64
        Their signatures where correspondences are known, else numbers in the order of first sight.
    positions : (M, 2) float64, m
        Map frame.
    covariances : (M, 2, 2) float64, m^2
        Of each position by itself.
    observations : (M,) int64
        How often each was seen.
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
        return f"LandmarkMap({len(self)} landmarks, {int(self.observations.sum())} sightings)"
