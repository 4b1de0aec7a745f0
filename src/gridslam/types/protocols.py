"""The small Protocols by which parts are swapped."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gridslam.scan import Beams, FloatArray, IntArray, Rows


@runtime_checkable
class DistanceMaps(Protocol):
    """Maps with distance queries, one per particle (see `gridslam.grid.TileMaps`)."""

    def distances(self, rows: Rows, poses: FloatArray, points: FloatArray) -> NDArray[np.float32]:
        """Return distance in m to the nearest occupied cell, (K, B), capped at `reach_m`.

        Of points (B, 2) in the base frame, seen from poses (K, 3).
        """
        ...

    def cast_rays(
        self, rows: Rows, poses: FloatArray, origin: FloatArray, directions: FloatArray, max_m: float
    ) -> NDArray[np.float32]:
        """Range in m (K, B) to the first occupied cell; `max_m` where there is none.

        Along directions (B, 2) from origin (2,), both in the base frame, seen from poses (K, 3).
        """
        ...

    @property
    def reach_m(self) -> float:
        """Where `distances` saturates."""
        ...


@runtime_checkable
class MotionSampler(Protocol):
    """A motion model conditioned on one increment: p(x_t | u_t, x_{t-1})."""

    def __call__(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw one successor (N, 3) for each pose (N, 3)."""
        ...

    def moments(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean successors (N, 3) and their covariances (N, 3, 3) in the world frame, to first order."""
        ...


@runtime_checkable
class MotionModel(Protocol):
    """Conditions on an increment: the pose (3,) of the robot now seen from where it was."""

    def __call__(self, increment: FloatArray) -> MotionSampler:
        """Return the sampler for this increment."""
        ...


@runtime_checkable
class ScanLikelihood(Protocol):
    """A measurement model conditioned on one scan: log p(z_t | x_t, m) up to a constant."""

    def __call__(self, maps: DistanceMaps, rows: Rows, poses: FloatArray) -> FloatArray:
        """Log likelihoods (K,) of poses (K, 3) in the maps `rows` (K,)."""
        ...


@runtime_checkable
class SensorModel(Protocol):
    """Conditions on the usable beams of a scan."""

    def __call__(self, beams: Beams) -> ScanLikelihood:
        """Return the weigher for this scan."""
        ...


@runtime_checkable
class Resampler(Protocol):
    """Draws which particles survive."""

    def __call__(self, weights: FloatArray, size: int, rng: np.random.Generator) -> IntArray:
        """Indices (size,) of the drawn particles, ascending, for weights (N,) >= 0 that sum to anything positive."""
        ...
