"""The values that travel between the parts: odometry, trajectories, matches and reports."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import freeze, require_array, require_generator, require_instance
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.scan import FloatArray, IntArray, LaserScan


@checked
def describe_time(stamp_ns: int) -> str:
    """Return a stamp in seconds, to the millisecond."""
    return f"{stamp_ns * 1e-9:.3f} s"


@checked
def describe_duration(seconds: float) -> str:
    """Return a duration in the unit in which people give it, from seconds to years; its sign is ignored."""
    size = abs(seconds)
    for unit, factor in (("years", 365.25 * 86400.0), ("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if size >= 2 * factor:
            digits = 1 if unit == "years" and size < 10 * factor else 0
            return f"{size / factor:.{digits}f} {unit}"
    return f"{size:.3g} s"


@checked
def describe_pose(pose: FloatArray) -> str:
    """Return a pose (3,), to the millimetre and the tenth of a milliradian."""
    x, y, theta = pose.tolist()
    return f"x {x:.3f} m, y {y:.3f} m, theta {theta:.4f} rad"


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class Odometry:
    """Pose of the integrated wheel odometry; `at` builds it from plain numbers.

    Attributes
    ----------
    stamp_ns : int, ns
        When.
    pose : (3,) float64
        Of the base in the odometry frame, [x m, y m, theta rad], finite.

    Raises
    ------
    ArgumentError
        An argument is of another type, shape or range.
    """

    stamp_ns: int
    pose: FloatArray

    def __post_init__(self) -> None:
        """Check the values."""
        require_instance("stamp_ns", self.stamp_ns, int, np.integer)
        require_array("pose", self.pose, np.float64, (3,))
        if not math.isfinite(sum(self.pose.tolist())):
            raise ArgumentError("pose", "finite x, y, theta", self.pose.tolist())

    def __repr__(self) -> str:
        """Return one line."""
        return f"Odometry({describe_time(self.stamp_ns)}: {describe_pose(self.pose)})"

    @classmethod
    def at(cls, stamp_ns: int, pose: ArrayLike) -> Odometry:
        """Copy the values; raises ArgumentError as the constructor does."""
        return cls(stamp_ns, freeze(pose, np.float64, (3,), "pose"))


@final
@checked
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

    def __repr__(self) -> str:
        """Return one line."""
        if not len(self):
            return "Trajectory(0 poses)"
        seconds = float(self.stamps_ns.max() - self.stamps_ns.min()) * 1e-9
        metres = float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())
        return f"Trajectory({len(self)} poses, {seconds:.1f} s, {metres:.1f} m)"

    def _repr_svg_(self) -> str:
        """Draw the path in a notebook, x to the right and y up, with a dot where it begins."""
        xy = self.poses[np.isfinite(self.poses).all(axis=1), :2] if len(self) else np.zeros((1, 2))
        low, extent = xy.min(axis=0), max(float(np.ptp(xy, axis=0).max()), 1e-3)
        at = 10 + 380 * (xy - low) / extent
        high = float(at[:, 1].max()) + 10
        at[:, 1] = high - at[:, 1]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in at[:: max(1, len(at) // 2000)].tolist())
        x, y = at[0].tolist()
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="400" height="{high:.0f}">'
            f'<polyline points="{points}" fill="none" stroke="#4a148c" stroke-width="1.5"/>'
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#f9a825"/></svg>'
        )


def require_measurement(odometry: object, scan: object) -> None:
    """Check the types of odometry and scan."""
    require_instance("odometry", odometry, Odometry, optional=True)
    require_instance("scan", scan, LaserScan)


def require_step(kind: type, state: object, odometry: object, scan: object, rng: object) -> None:
    """Check the types of state, odometry, scan and generator, before a step consumes the state."""
    require_instance("state", state, kind)
    require_measurement(odometry, scan)
    require_generator(rng)


class SkipReason(Enum):
    """Why a scan did not update the particles."""

    BETWEEN_KEY_SCANS = "between key scans"
    NO_VALID_BEAM = "no valid beam"


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """Result of matching one scan from K guesses, or each of K scans from its own.

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

    def select(self, chosen: IntArray) -> Match:
        """Matches `chosen` (M,) of them."""
        return Match(self.poses[chosen], self.information[chosen], self.score[chosen])


@final
@dataclass(frozen=True, slots=True, eq=False)
class StepReport:
    """Report of one filter step.

    Attributes
    ----------
    stamp_ns : int
        Stamp of the scan.
    pose : (3,) float64
        Of the best particle, smoothed over its matches, and so some millimetres from its row of `poses`; map frame.
    computed_covariance : (3, 3) float64, or a function that returns it
        Of that pose: what `covariance` returns. It is computed when it is asked for, as most scans of a log never are.
    key_from_base : (3,) float64
        The robot seen from the last key scan before this one, as tracked.
    degenerate_direction : (2,) float64 or None
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
    computed_covariance: FloatArray | Callable[[], FloatArray]
    key_from_base: FloatArray
    degenerate_direction: FloatArray | None = None
    lost: bool = False
    skipped: SkipReason | None = None
    best: int = 0
    n_eff: float = field(default=float("nan"))
    poses: FloatArray | None = None
    log_weights: FloatArray | None = None
    parents: IntArray | None = None
    closures: tuple[tuple[int, int], ...] = ()
    corrected: bool = False

    @property
    def covariance(self) -> FloatArray:
        """Covariance (3, 3) of the pose, by x, y and theta in the map frame: m^2, m rad, rad^2."""
        computed = self.computed_covariance
        return computed() if callable(computed) else computed

    def __repr__(self) -> str:
        """Return one line."""
        what = f"key scan, n_eff {self.n_eff:.1f}" if self.skipped is None else self.skipped.value
        lost = ", lost" if self.lost else ""
        return f"StepReport({describe_time(self.stamp_ns)}: {describe_pose(self.pose)}, {what}{lost})"
