"""Pipeline observers: recorders of trajectory and statistics."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import COUNT
from gridslam.errors import ArgumentError
from gridslam.serialization import read_array, select_part
from gridslam.slam.full_slam.full_trajectory import TrackedScans, full_trajectory
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, IntArray, SkipReason, StepReport, Trajectory

__all__ = ["Latency", "RunStatistics", "StatisticsRecorder", "TrajectoryRecorder"]

_LOG_STEP = math.log(1.01)
_SHORTEST_S = 1e-7
_MOST_BINS = 4000  # 1e17 s


@final
class TrajectoryRecorder:
    """Records the data of the online and the full trajectory of all scans.

    Between two key scans all particles move with the tracker (see `gridslam.slam.full_slam.full_trajectory`).
    Uses 8 bytes of memory for a scan, and 64 more for one that is not where the last one was.
    """

    __slots__ = ("_key_from_base", "_keys", "_last", "_online", "_repeats", "_stamps_ns", "_steps")

    def __init__(self) -> None:
        """Start without scans; the first one must be the filter's first."""
        self._steps = 0
        self._stamps_ns = array("q")
        self._repeats = array("q")  # successive scans at the same poses, which the arrays below have once
        self._keys = array("q")
        self._online = array("d")
        self._key_from_base = array("d")
        self._last: list[float] = []

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Record one scan."""
        self._stamps_ns.append(report.stamp_ns)
        pose = report.pose.tolist()
        key_from_base = report.key_from_base.tolist()
        poses = pose + key_from_base
        if report.skipped is not None and poses == self._last:
            self._repeats[-1] += 1
            return
        self._last = poses
        self._steps += report.skipped is None
        self._repeats.append(1)
        self._keys.append(self._steps - 1)
        self._online.extend(pose)
        self._key_from_base.extend(key_from_base)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays: `stamps_ns` (N,) of the scans, and the M poses at which they were one after the other.

        `repeats` (M,) int64 is the number of scans at each, `keys` (M,) int64 the key scan at or before it, `online`
        and `key_from_base` are (M, 3) float64.
        """
        return {
            "stamps_ns": _as_integers(self._stamps_ns),
            "repeats": _as_integers(self._repeats),
            "keys": _as_integers(self._keys),
            "online": _as_poses(self._online),
            "key_from_base": _as_poses(self._key_from_base),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> TrajectoryRecorder:
        """Restore from the arrays of `to_arrays`; raises ArgumentError for other arrays."""
        self = cls()
        sizes: dict[str, int] = {}
        for name, kept, shape in (
            ("stamps_ns", self._stamps_ns, ("scans",)),
            ("repeats", self._repeats, ("poses",)),
            ("keys", self._keys, ("poses",)),
            ("online", self._online, ("poses", 3)),
            ("key_from_base", self._key_from_base, ("poses", 3)),
        ):
            kept.frombytes(read_array(arrays, name, kept.typecode, shape, sizes).tobytes())
        if sum(self._repeats) != len(self._stamps_ns) or min(self._repeats, default=1) < 1:
            raise ArgumentError(
                "repeats", f"positive numbers of {len(self._stamps_ns)} scans in all", sum(self._repeats)
            )
        if self._keys:
            self._steps = self._keys[-1] + 1
            self._last = (self._online[-3:] + self._key_from_base[-3:]).tolist()
        return self

    @property
    def keys(self) -> IntArray:
        """Index of the key scan at or before each scan, from 0: (N,) int64."""
        return np.repeat(_as_integers(self._keys), self._repeats)

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
        return np.repeat(_as_poses(self._key_from_base), self._repeats, axis=0)

    def online_trajectory(self) -> Trajectory:
        """Return the online trajectory: the pose of the best particle at each scan."""
        poses = np.repeat(_as_poses(self._online), self._repeats, axis=0)
        return Trajectory(_as_integers(self._stamps_ns), poses)

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
class _Durations:
    """Histogram of durations in steps of 1 %, and their maximum: a day of scans takes no more memory than a minute."""

    __slots__ = ("bins", "max_s")

    def __init__(self) -> None:
        self.bins: Counter[int] = Counter()
        self.max_s = 0.0

    def add(self, seconds: float) -> None:
        self.bins[round(math.log(max(seconds, _SHORTEST_S)) / _LOG_STEP)] += 1
        self.max_s = max(self.max_s, seconds)

    def summarize(self) -> Latency:
        """Return median and 99th percentile within 0.5 %; zeros if there are none."""
        if not self.bins:
            return Latency(0.0, 0.0, 0.0)
        bins = np.array(sorted(self.bins))
        reached = np.cumsum([self.bins[each] for each in bins.tolist()])
        median, p99 = np.exp(_LOG_STEP * bins[np.searchsorted(reached, np.array([0.5, 0.99]) * reached[-1])]).tolist()
        return Latency(min(median, self.max_s), min(p99, self.max_s), self.max_s)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return `bins` (B, 2) int64, number and count of each, and `max_s` float64."""
        return {"bins": np.array(sorted(self.bins.items()), np.int64).reshape(-1, 2), "max_s": np.array(self.max_s)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> _Durations:
        self = cls()
        bins = read_array(arrays, "bins", np.int64, (None, 2))
        if (np.diff(bins[:, 0]) < 1).any() or (np.abs(bins[:, 0]) > _MOST_BINS).any() or (bins[:, 1] < 1).any():
            raise ArgumentError("bins", f"ascending numbers up to {_MOST_BINS}, each with a count of 1 or more", bins)
        self.bins = Counter(dict(bins.tolist()))
        self.max_s = float(read_array(arrays, "max_s", np.float64, ()))
        return self


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
    n_eff_mean, n_eff_min : float
        Effective sample size over the key scans.
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
    n_eff_mean: float
    n_eff_min: float
    latency: Latency
    key_latency: Latency


@final
class StatisticsRecorder:
    """Counts and times the steps of a run; uses 16 bytes of memory per key scan."""

    __slots__ = (
        "_corrections",
        "_degenerate",
        "_key_seconds",
        "_lost",
        "_n_eff",
        "_resamplings",
        "_seconds",
        "_skipped",
    )

    def __init__(self) -> None:
        """Start without scans."""
        self._seconds = _Durations()
        self._key_seconds = array("d")
        self._n_eff = array("d")
        self._skipped: Counter[SkipReason] = Counter()
        self._resamplings = self._lost = self._degenerate = self._corrections = 0

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Record one scan."""
        self._seconds.add(seconds)
        self._lost += report.lost
        if report.skipped is not None:
            self._skipped[report.skipped] += 1
            return
        self._key_seconds.append(seconds)
        self._n_eff.append(report.n_eff)
        self._resamplings += report.parents is not None
        self._degenerate += report.degenerate_direction is not None
        self._corrections += report.corrected

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return plain arrays: `n_eff` and `key_seconds` (K,) float64 of the key scans, `counts` int64, `seconds.*`.

        The counts are resamplings, lost and undetermined scans, corrections, and scans skipped for each reason.
        `seconds.bins` (B, 2) int64 and `seconds.max_s` float64 are the histogram of the times of all scans.
        """
        skipped = [self._skipped[reason] for reason in SkipReason]
        return {
            "n_eff": np.frombuffer(self._n_eff.tobytes()),
            "key_seconds": np.frombuffer(self._key_seconds.tobytes()),
            "counts": np.array(
                [self._resamplings, self._lost, self._degenerate, self._corrections, *skipped], np.int64
            ),
            **{f"seconds.{name}": values for name, values in self._seconds.to_arrays().items()},
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> StatisticsRecorder:
        """Restore from the arrays of `to_arrays`; raises ArgumentError for other arrays."""
        self = cls()
        self._seconds = _Durations.from_arrays(select_part(arrays, "seconds"))
        sizes: dict[str, int] = {}
        self._n_eff.frombytes(read_array(arrays, "n_eff", np.float64, ("key scans",), sizes).tobytes())
        self._key_seconds.frombytes(read_array(arrays, "key_seconds", np.float64, ("key scans",), sizes).tobytes())
        counts = read_array(arrays, "counts", np.int64, (4 + len(SkipReason),))
        COUNT.require("counts", counts, {})
        self._resamplings, self._lost, self._degenerate, self._corrections, *skipped = counts.tolist()
        self._skipped = Counter({reason: n for reason, n in zip(SkipReason, skipped, strict=True) if n})
        return self

    def summary(self) -> RunStatistics:
        """Summarize the scans so far."""
        n_eff = np.frombuffer(self._n_eff.tobytes())
        return RunStatistics(
            scans=len(n_eff) + self._skipped.total(),
            key_scans=len(n_eff),
            skipped=dict(self._skipped),
            resamplings=self._resamplings,
            lost=self._lost,
            degenerate=self._degenerate,
            corrections=self._corrections,
            n_eff_mean=float(n_eff.mean()) if len(n_eff) else 0.0,
            n_eff_min=float(n_eff.min()) if len(n_eff) else 0.0,
            latency=self._seconds.summarize(),
            key_latency=Latency.of(np.frombuffer(self._key_seconds.tobytes())),
        )


def _as_integers(values: array[int]) -> IntArray:
    return np.frombuffer(values.tobytes(), np.int64)


def _as_poses(values: array[float]) -> FloatArray:
    return np.frombuffer(values.tobytes()).reshape(-1, 3)
