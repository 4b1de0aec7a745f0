"""Observers of the pipeline: what a run leaves behind besides its map."""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry.se2 import compose
from gridslam.slam.state import GridFastSlamState
from gridslam.types import FloatArray, IntArray, SkipReason, StepReport, Trajectory

__all__ = ["Latency", "RunStatistics", "StatisticsRecorder", "TrajectoryRecorder"]


@final
class TrajectoryRecorder:
    """Keeps what is needed for a pose of every scan: as it was told at the time, and as the end tells it.

    Between two key scans all particles move with the tracker, so a scan's pose is that of its key scan, moved on.
    Memory is 64 bytes a scan.
    """

    __slots__ = ("_from_key", "_keys", "_online", "_stamps_ns", "_steps")

    def __init__(self) -> None:
        """Begin without any scan; the first one must be the filter's first."""
        self._steps = 0
        self._stamps_ns, self._keys = array("q"), array("q")
        self._online, self._from_key = array("d"), array("d")

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Take note of one scan."""
        self._steps += report.skipped is None
        self._stamps_ns.append(report.stamp_ns)
        self._keys.append(self._steps - 1)
        self._online.extend(report.pose.tolist())
        self._from_key.extend(report.key_from_base.tolist())

    def online(self) -> Trajectory:
        """Give the online-SLAM answer: what the best particle said at the time of each scan."""
        return Trajectory(_integers(self._stamps_ns), _poses(self._online))

    def full(self, state: GridFastSlamState) -> Trajectory:
        """Give the full-SLAM answer: the trajectory of the best particle of `state`, a pose for every scan."""
        past = state.ancestry.trajectory(state.best)
        poses = compose(past[_integers(self._keys)], _poses(self._from_key))
        return Trajectory(_integers(self._stamps_ns), poses)


@final
@dataclass(frozen=True, slots=True)
class Latency:
    """Time of one step, s, over many."""

    median_s: float
    p99_s: float
    max_s: float

    @classmethod
    def of(cls, seconds: FloatArray) -> Latency:
        """Summarize times (N,); zeros where there are none."""
        if not len(seconds):
            return cls(0.0, 0.0, 0.0)
        return cls(float(np.median(seconds)), float(np.percentile(seconds, 99)), float(seconds.max()))


@final
@dataclass(frozen=True, slots=True)
class RunStatistics:
    """What a run did.

    Attributes
    ----------
    scans, key_scans : int
        Scans taken, and those of them that stepped the particles.
    skipped : dict of SkipReason to int
        Scans that did not, by reason.
    resamplings, lost, undetermined : int
        Key scans after which the particles were resampled; scans at which the robot was lost; key scans that left a
        direction undetermined.
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
    undetermined: int
    n_eff_mean: float
    n_eff_min: float
    latency: Latency
    key_latency: Latency


@final
class StatisticsRecorder:
    """Counts and times the steps of a run; 17 bytes a scan."""

    __slots__ = ("_is_key", "_lost", "_n_eff", "_resamplings", "_seconds", "_skipped", "_undetermined")

    def __init__(self) -> None:
        """Begin without any scan."""
        self._seconds, self._is_key, self._n_eff = array("d"), array("b"), array("d")
        self._skipped: Counter[SkipReason] = Counter()
        self._resamplings = self._lost = self._undetermined = 0

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Take note of one scan."""
        self._seconds.append(seconds)
        self._is_key.append(report.skipped is None)
        self._lost += report.lost
        if report.skipped is not None:
            self._skipped[report.skipped] += 1
            return
        self._n_eff.append(report.n_eff)
        self._resamplings += report.parents is not None
        self._undetermined += report.undetermined is not None

    def summary(self) -> RunStatistics:
        """Summarize the scans so far."""
        seconds, is_key = np.frombuffer(self._seconds.tobytes()), np.frombuffer(self._is_key.tobytes(), np.bool_)
        n_eff = np.frombuffer(self._n_eff.tobytes())
        return RunStatistics(
            scans=len(seconds),
            key_scans=len(n_eff),
            skipped=dict(self._skipped),
            resamplings=self._resamplings,
            lost=self._lost,
            undetermined=self._undetermined,
            n_eff_mean=float(n_eff.mean()) if len(n_eff) else 0.0,
            n_eff_min=float(n_eff.min()) if len(n_eff) else 0.0,
            latency=Latency.of(seconds),
            key_latency=Latency.of(seconds[is_key]),
        )


def _integers(values: array[int]) -> IntArray:
    return np.frombuffer(values.tobytes(), np.int64)


def _poses(values: array[float]) -> FloatArray:
    return np.frombuffer(values.tobytes()).reshape(-1, 3)
