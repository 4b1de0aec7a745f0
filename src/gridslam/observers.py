"""Pipeline observers: recorders of trajectory and statistics."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import COUNT
from gridslam.serialization import read_array
from gridslam.slam.full_slam.full_trajectory import TrackedScans, full_trajectory
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, IntArray, SkipReason, StepReport, Trajectory


@final
class TrajectoryRecorder:
    """Records the data of the online and the full trajectory of all scans.

    Between two key scans all particles move with the tracker (see `gridslam.slam.full_slam.full_trajectory`).
    Uses 64 bytes of memory for a scan.
    """

    __slots__ = ("_key_from_base", "_keys", "_online", "_stamps_ns")

    def __init__(self) -> None:
        """Start without scans; the first one must be the filter's first."""
        self._stamps_ns = array("q")
        self._keys = array("q")
        self._online = array("d")
        self._key_from_base = array("d")

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Record one scan."""
        self._stamps_ns.append(report.stamp_ns)
        last = self._keys[-1] if self._keys else -1
        self._keys.append(last + (report.skipped is None))
        self._online.extend(report.pose.tolist())
        self._key_from_base.extend(report.key_from_base.tolist())

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays: `stamps_ns` and `keys` (N,) int64, `online` and `key_from_base` (N, 3) float64."""
        return {
            "stamps_ns": _as_integers(self._stamps_ns),
            "keys": self.keys,
            "online": _as_poses(self._online),
            "key_from_base": self.key_from_base,
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> TrajectoryRecorder:
        """Restore from the arrays of `to_arrays`; raises ArgumentError for other arrays."""
        self = cls()
        sizes: dict[str, int] = {}
        for name, kept, shape in (
            ("stamps_ns", self._stamps_ns, ("scans",)),
            ("keys", self._keys, ("scans",)),
            ("online", self._online, ("scans", 3)),
            ("key_from_base", self._key_from_base, ("scans", 3)),
        ):
            kept.frombytes(read_array(arrays, name, kept.typecode, shape, sizes).tobytes())
        return self

    @property
    def keys(self) -> IntArray:
        """Index of the key scan at or before each scan, from 0: (N,) int64."""
        return _as_integers(self._keys)

    @property
    def key_scans(self) -> IntArray:
        """Which scans are key scans: (T,) int64."""
        return np.flatnonzero(np.diff(self.keys, prepend=-1))

    def tracked_scans(self, first_key: int = 0) -> TrackedScans:
        """Return the scans as a drive whose first key scan is number `first_key`."""
        return TrackedScans(first_key + self.keys, self.key_from_base)

    @property
    def key_from_base(self) -> FloatArray:
        """Tracked motion of each scan since its key scan: (N, 3) float64."""
        return _as_poses(self._key_from_base)

    def online_trajectory(self) -> Trajectory:
        """Return the online trajectory: the pose of the best particle at each scan."""
        return Trajectory(_as_integers(self._stamps_ns), _as_poses(self._online))

    def best_trajectory(self, state: GridFastSlamState) -> Trajectory:
        """Return the path of the best particle of `state`, a pose for every scan: the filter's full-SLAM estimate."""
        poses = full_trajectory(state.ancestry.trajectory(state.best), self.keys, self.key_from_base)
        return Trajectory(_as_integers(self._stamps_ns), poses)


@final
@dataclass(frozen=True, slots=True)
class Latency:
    """Statistics of the time per step, s."""

    median_s: float
    p99_s: float
    max_s: float

    @classmethod
    def of(cls, seconds: FloatArray) -> Latency:
        """Summarize times (N,); zeros if there are none."""
        if not len(seconds):
            return cls(0.0, 0.0, 0.0)
        return cls(float(np.median(seconds)), float(np.percentile(seconds, 99)), float(seconds.max()))


@final
@dataclass(frozen=True, slots=True)
class RunStatistics:
    """Statistics of a run.

    Attributes
    ----------
    scans, key_scans : int
        Number of scans, and of those that updated the particles.
    skipped : dict of SkipReason to int
        Number of scans that did not, by reason.
    resamplings, lost, degenerate, corrections : int
        Key scans with resampling; scans at which the robot was lost; key scans with a degenerate direction; key scans
        with a correction of the trajectory.
    particles_mean, n_eff_mean, n_eff_min : float
        Number of particles and effective sample size over the key scans.
    latency, key_latency : Latency
        Of all scans, and of the key scans.
    """

    scans: int
    key_scans: int
    skipped: dict[SkipReason, int]
    resamplings: int
    lost: int
    degenerate: int
    corrections: int
    particles_mean: float
    n_eff_mean: float
    n_eff_min: float
    latency: Latency
    key_latency: Latency


@final
class StatisticsRecorder:
    """Counts and times the steps of a run; uses 8 bytes of memory for a scan and 16 more for a key scan."""

    __slots__ = (
        "_corrections",
        "_degenerate",
        "_key_seconds",
        "_lost",
        "_n_eff",
        "_particles",
        "_resamplings",
        "_seconds",
        "_skipped",
    )

    def __init__(self) -> None:
        """Start without scans."""
        self._seconds = array("d")
        self._key_seconds = array("d")
        self._n_eff = array("d")
        self._skipped: Counter[SkipReason] = Counter()
        self._resamplings = self._lost = self._degenerate = self._corrections = self._particles = 0

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Record one scan."""
        self._seconds.append(seconds)
        self._lost += report.lost
        if report.skipped is not None:
            self._skipped[report.skipped] += 1
            return
        self._key_seconds.append(seconds)
        self._n_eff.append(report.n_eff)
        self._particles += 0 if report.poses is None else len(report.poses)
        self._resamplings += report.parents is not None
        self._degenerate += report.degenerate_direction is not None
        self._corrections += report.corrected

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays: `n_eff` and `key_seconds` (K,) of the key scans, `seconds` (S,) of all, `counts` int64.

        The counts are resamplings, lost and undetermined scans, corrections, and scans skipped for each reason;
        `particles` is the sum over the key scans.
        """
        skipped = [self._skipped[reason] for reason in SkipReason]
        return {
            "seconds": np.frombuffer(self._seconds.tobytes()),
            "n_eff": np.frombuffer(self._n_eff.tobytes()),
            "key_seconds": np.frombuffer(self._key_seconds.tobytes()),
            "particles": np.array(self._particles),
            "counts": np.array(
                [self._resamplings, self._lost, self._degenerate, self._corrections, *skipped], np.int64
            ),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> StatisticsRecorder:
        """Restore from the arrays of `to_arrays`; raises ArgumentError for other arrays."""
        self = cls()
        sizes: dict[str, int] = {}
        self._seconds.frombytes(read_array(arrays, "seconds", np.float64, ("scans",), sizes).tobytes())
        self._n_eff.frombytes(read_array(arrays, "n_eff", np.float64, ("key scans",), sizes).tobytes())
        self._key_seconds.frombytes(read_array(arrays, "key_seconds", np.float64, ("key scans",), sizes).tobytes())
        counts = read_array(arrays, "counts", np.int64, (4 + len(SkipReason),))
        COUNT.require("counts", counts, {})
        self._particles = int(read_array(arrays, "particles", np.int64, ()))
        self._resamplings, self._lost, self._degenerate, self._corrections, *skipped = counts.tolist()
        self._skipped = Counter({reason: n for reason, n in zip(SkipReason, skipped, strict=True) if n})
        return self

    def summary(self) -> RunStatistics:
        """Summarize the scans so far."""
        n_eff = np.frombuffer(self._n_eff.tobytes())
        return RunStatistics(
            scans=len(self._seconds),
            key_scans=len(n_eff),
            skipped=dict(self._skipped),
            resamplings=self._resamplings,
            lost=self._lost,
            degenerate=self._degenerate,
            corrections=self._corrections,
            particles_mean=self._particles / max(len(n_eff), 1),
            n_eff_mean=float(n_eff.mean()) if len(n_eff) else 0.0,
            n_eff_min=float(n_eff.min()) if len(n_eff) else 0.0,
            latency=Latency.of(np.frombuffer(self._seconds.tobytes())),
            key_latency=Latency.of(np.frombuffer(self._key_seconds.tobytes())),
        )


def _as_integers(values: array[int]) -> IntArray:
    return np.frombuffer(values.tobytes(), np.int64)


def _as_poses(values: array[float]) -> FloatArray:
    return np.frombuffer(values.tobytes()).reshape(-1, 3)
