"""The values that travel between the parts, and the small Protocols by which parts are swapped.

Poses are rows ``[x m, y m, theta rad]`` with theta in [-pi, pi); grids are ``[row = y, column = x]``; a stamp is int64
nanoseconds; angles are counter-clockwise radians.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol, final, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import frozen, require_array, require_covariance, require_instance
from gridslam.errors import ArgumentError
from gridslam.scan import (
    BeamEnds,
    Beams,
    BeamStatus,
    EndPoints,
    FloatArray,
    IntArray,
    LaserScan,
    Rows,
    ScanGeometry,
)

__all__ = [
    "BeamEnds", "BeamStatus", "Beams", "DistanceMaps", "EndPoints", "FloatArray", "IntArray", "LaserScan", "Match",
    "MotionModel", "MotionSampler", "OccupancyGrid", "Odometry", "Resampler", "Rows", "ScanGeometry", "SensorModel",
    "SkipReason", "StepReport", "Trajectory", "Weigher",
    "require_measurement",
]  # fmt: skip


@final
@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Where the wheels believe the robot to be; `at` makes it of plain numbers.

    Attributes
    ----------
    stamp_ns : int, ns
        When.
    pose : (3,) float64
        Of the base in the odometry frame, [x m, y m, theta rad], finite.
    covariance : (3, 3) float64 or None, m^2, m rad, rad^2
        Of the motion since the log's odometry before this one, by x, y and theta in the base frame at that time;
        symmetric and positive definite. None where nothing trustworthy is known.

    Raises
    ------
    ArgumentError
        An argument is of another type, shape or range.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check what is given."""
        require_instance("stamp_ns", self.stamp_ns, int, np.integer)
        require_array("pose", self.pose, np.float64, (3,))
        if not math.isfinite(sum(self.pose.tolist())):
            raise ArgumentError("pose", "finite x, y, theta", self.pose.tolist())
        if self.covariance is not None:
            require_covariance("covariance", self.covariance)

    @classmethod
    def at(cls, stamp_ns: int, pose: ArrayLike, covariance: ArrayLike | None = None) -> Odometry:
        """Copy what is given; raises ArgumentError as the constructor does."""
        checked = frozen(pose, np.float64, (3,), "pose")
        spread = None if covariance is None else frozen(covariance, np.float64, (3, 3), "covariance")
        return cls(stamp_ns, checked, spread)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Stamps (N,) int64 ns, in the order of the measurements (they may go backwards), and poses (N, 3)."""

    stamps_ns: IntArray
    poses: FloatArray

    def __post_init__(self) -> None:
        """Check that there is one stamp for each pose."""
        require_array("stamps_ns", self.stamps_ns, np.int64, (len(self.stamps_ns),))
        require_array("poses", self.poses, np.float64, (len(self.stamps_ns), 3))

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps_ns)


@final
@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """A rectangular map, as it is published and written.

    Attributes
    ----------
    log_odds : (H, W) float32, nats
        Log-odds of occupancy; meaningful where `known`.
    known : (H, W) bool
        Whether any beam has told anything about the cell.
    resolution_m : float
        Side of a cell.
    origin : (float, float), m
        World coordinates of the lower left corner of cell [0, 0].
    """

    log_odds: NDArray[np.float32]
    known: NDArray[np.bool_]
    resolution_m: float
    origin: tuple[float, float]

    def __post_init__(self) -> None:
        """Check that all belongs together."""
        require_instance("log_odds", self.log_odds, np.ndarray)
        if self.log_odds.ndim != 2:
            raise ArgumentError("log_odds", "shape (H, W)", self.log_odds.shape)
        require_array("known", self.known, np.bool_, self.log_odds.shape)
        if not 0 < self.resolution_m < math.inf:
            raise ArgumentError("resolution_m", "a finite length > 0 m", self.resolution_m)
        frozen(self.origin, np.float64, (2,), "origin")

    @property
    def probability(self) -> NDArray[np.float32]:
        """Occupancy probability (H, W); 0.5 where unknown."""
        odds = np.where(self.known, self.log_odds, np.float32(0))
        return (1.0 / (1.0 + np.exp(-odds))).astype(np.float32)


def require_measurement(odometry: object, scan: object) -> None:
    """Refuse what is no measurement for a filter: neither of them, or both in the wrong order."""
    require_instance("odometry", odometry, Odometry, optional=True)
    require_instance("scan", scan, LaserScan)


class SkipReason(Enum):
    """Why a scan did not step the particles."""

    BETWEEN_KEY_SCANS = "between key scans"
    NO_VALID_BEAM = "no valid beam"


@final
@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Result of matching one scan from K guesses.

    Attributes
    ----------
    poses : (K, 3) float64
        Where the scan fits best.
    information : (K, 3, 3) float64
        Normal matrix of the beams' distances to the map in m (no prior) at the poses, by x and y in m and theta in rad,
        in the world frame: divided by a beam's variance in m^2 it is the information.
    score : (K,) float64
        Sum over beams of the robust weights in [0, B]: how many beams agree with the map.
    """

    poses: FloatArray
    information: FloatArray
    score: FloatArray


@final
@dataclass(frozen=True, slots=True, eq=False)
class StepReport:
    """What one step of the filter tells its observers.

    Attributes
    ----------
    stamp_ns : int
        Stamp of the scan.
    pose, covariance : (3,), (3, 3) float64
        Of the best particle, the one of greatest log weight accumulated along its ancestry; map frame.
    key_from_base : (3,) float64
        The robot seen from the last key scan before this one, as tracked.
    undetermined : (2,) float64 or None
        Unit vector in the map frame along which the scan did not determine the position.
    lost : bool
        The scan agrees with the map too little to trust the pose.
    skipped : SkipReason or None
        Why the particles were not stepped; None at a key scan.
    best : int
        Index of the best particle after this step.
    n_eff : float
        Effective sample size before resampling.
    poses, log_weights : (N, 3), (N,) float64 or None
        Particles at a key scan, before resampling; log weights are normalized.
    parents : (N,) int64 or None
        For each particle after the step the index of the one it continues; None where nothing was resampled.
    closures : tuple of (int, int)
        Key scans just recognized to show one place, older and later one, counted from 0.
    corrected : bool
        The past was corrected after this step: all particles have a new trajectory and map.
    """

    stamp_ns: int
    pose: FloatArray
    covariance: FloatArray
    key_from_base: FloatArray
    undetermined: FloatArray | None = None
    lost: bool = False
    skipped: SkipReason | None = None
    best: int = 0
    n_eff: float = field(default=float("nan"))
    poses: FloatArray | None = None
    log_weights: FloatArray | None = None
    parents: IntArray | None = None
    closures: tuple[tuple[int, int], ...] = ()
    corrected: bool = False


@runtime_checkable
class DistanceMaps(Protocol):
    """Maps that tell distances: one row of a table of maps for each particle (see `gridslam.grid.TileMaps`)."""

    def distances(self, rows: Rows, poses: FloatArray, points: FloatArray) -> NDArray[np.float32]:
        """Distance in m to the nearest occupied cell, (K, B), capped at `reach_m`.

        Of points (B, 2) in the base frame, seen from poses (K, 3).
        """

    def cast_rays(
        self, rows: Rows, poses: FloatArray, origin: FloatArray, directions: FloatArray, max_m: float
    ) -> NDArray[np.float32]:
        """Range in m (K, B) to the first occupied cell; `max_m` where there is none.

        Along directions (B, 2) from origin (2,), both in the base frame, seen from poses (K, 3).
        """

    @property
    def reach_m(self) -> float:
        """Where `distances` saturates."""


@runtime_checkable
class MotionSampler(Protocol):
    """A motion model conditioned on one increment: p(x_t | u_t, x_{t-1})."""

    def __call__(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw one successor (N, 3) for each pose (N, 3)."""

    def moments(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean successors (N, 3) and their covariances (N, 3, 3) in the world frame, to first order."""


@runtime_checkable
class MotionModel(Protocol):
    """Conditions on an increment: the pose (3,) of the robot now seen from where it was."""

    def __call__(self, increment: FloatArray) -> MotionSampler:
        """Return the sampler for this increment."""


@runtime_checkable
class Weigher(Protocol):
    """A measurement model conditioned on one scan: log p(z_t | x_t, m) up to a constant."""

    def __call__(self, maps: DistanceMaps, rows: Rows, poses: FloatArray) -> FloatArray:
        """Log likelihoods (K,) of poses (K, 3) in the maps `rows` (K,)."""


@runtime_checkable
class SensorModel(Protocol):
    """Conditions on the usable beams of a scan."""

    def __call__(self, beams: Beams) -> Weigher:
        """Return the weigher for this scan."""


@runtime_checkable
class Resampler(Protocol):
    """Draws which particles survive."""

    def __call__(self, weights: FloatArray, size: int, rng: np.random.Generator) -> IntArray:
        """Indices (size,) of the drawn particles, ascending, for weights (N,) >= 0 that sum to anything positive."""
