"""Logs of landmarks: what their readers have in common, and how a file's own reader is found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, final, runtime_checkable

from gridslam.arguments import describe
from gridslam.errors import ArgumentError, InputError
from gridslam.io.text import read_head
from gridslam.models.landmark import LandmarkStep, ObservationKind
from gridslam.types import FloatArray, IntArray, Trajectory

__all__ = ["LandmarkLog", "LandmarkLogStatistics", "LandmarkTruth", "open_landmark_log", "open_landmark_log_if_path"]

_HEAD_BYTES = 4096
_KNOWN = "an odometry file of UTIAS MRCLAM (.._Odometry.dat) or lines ODOMETRY and LANDMARK (Victoria Park)"


@final
@dataclass(slots=True)
class LandmarkLogStatistics:
    """What was met so far while a log is read.

    Attributes
    ----------
    odometry : int
        Readings of the odometry.
    steps : int
        Steps given.
    observations : int
        Number of landmark observations.
    robots : int
        Observations of other robots, which are no landmarks; left out.
    unknown : int
        Observations with an unknown barcode (misread); left out.
    first_ns, last_ns : int
        Stamps of the first and the last step.
    """

    odometry: int = 0
    steps: int = 0
    observations: int = 0
    robots: int = 0
    unknown: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def duration_s(self) -> float:
        """From the first step to the last, s."""
        return 1e-9 * (self.last_ns - self.first_ns)

    def count(self, step: LandmarkStep) -> LandmarkStep:
        """Count a step, and give it back."""
        if not self.steps:
            self.first_ns = step.stamp_ns
        self.last_ns = step.stamp_ns
        self.steps += 1
        self.observations += len(step.observations)
        return step


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkTruth:
    """The truth about a log, in a frame of its own.

    Attributes
    ----------
    trajectory : Trajectory or None
        Of the robot.
    landmarks : (M,) int64
        Signatures of the landmarks.
    positions : (M, 2) float64, m
        Where they are.
    """

    trajectory: Trajectory | None
    landmarks: IntArray
    positions: FloatArray


@runtime_checkable
class LandmarkLog(Protocol):
    """A log of landmarks; each iteration rereads it incrementally."""

    path: Path
    kind: ObservationKind
    stamped: bool
    """Whether its stamps are times; else they only count the steps, a second each."""
    statistics: LandmarkLogStatistics
    truth: LandmarkTruth | None

    def __iter__(self) -> Iterator[LandmarkStep]:
        """Yield the steps in the order of time; raises InputError with the line where the log cannot be used."""


def open_landmark_log(path: str | Path) -> LandmarkLog:
    """Open a log of landmarks (plain, .gz or .bz2); the format is detected from name and content.

    Raises
    ------
    InputError
        There is no such file, it is of another form, or a file that belongs to it is not beside it.
    """
    from gridslam.io.landmarks.mrclam import MrclamLog
    from gridslam.io.landmarks.victoria_park import VictoriaParkLog

    where = Path(path)
    if where.is_dir():
        raise InputError(path, f"expected {_KNOWN}, got a folder")
    lines = read_head(where, _HEAD_BYTES).decode("latin-1").splitlines()
    first = next((line.split()[0] for line in lines if line.split() and not line.startswith("#")), "")
    if MrclamLog.names(where):
        return MrclamLog(where)
    if first in VictoriaParkLog.TAGS:
        return VictoriaParkLog(where)
    raise InputError(path, f"expected {_KNOWN}, got a line that begins with {first[:40]!r}")


def open_landmark_log_if_path(log: str | Path | LandmarkLog) -> LandmarkLog:
    """Open the log at a path, and give one that is open as it is; raises ArgumentError for what is neither."""
    if isinstance(log, str | Path):
        return open_landmark_log(log)
    if not isinstance(log, LandmarkLog):
        raise ArgumentError("log", "str, Path or a log as open_landmark_log gives it", describe(log))
    return log
