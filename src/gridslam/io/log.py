"""What every log offers whatever its format, and the choice of the reader that a file needs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TypeAlias, final, runtime_checkable

from gridslam.arguments import describe
from gridslam.errors import ArgumentError, InputError
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement

__all__ = ["Log", "LogOptions", "LogSource", "open_if_path", "open_log"]


@runtime_checkable
class Log(Protocol):
    """A stream of measurements that can be read again from its start."""

    @property
    def path(self) -> Path:
        """The file or folder."""

    @property
    def statistics(self) -> LogStatistics:
        """What the latest iteration has met so far."""

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start; raises InputError where it cannot be read on."""


@final
@dataclass(frozen=True, slots=True)
class LogOptions:
    """What to read of a log, and how.

    Attributes
    ----------
    scan_topics : tuple of str
        Topics (bags) or sensors (other logs) whose scans are read; empty: all that are unambiguous.
    odometry_topic : str or None
        Topic of the odometry of a bag; found by its type if not given.
    odometry_frame, base_frame : str or None
        Take the odometry of a bag from the transforms between these frames; found by their names if not given.
    no_odometry : bool
        Give every scan without odometry, whatever the log has.
    keep_truncated : bool
        Read a log that is cut off as far as it goes instead of refusing it.
    start_s : float, >= 0
        Skip the scans less than this many seconds after the first.
    duration_s : float or None, > 0
        Skip the scans this many seconds or more after the start.
    every : int, >= 1
        Use only every n-th of the remaining scans of each sensor, from the first on.

    Raises
    ------
    ArgumentError
        A number is out of its range.
    """

    scan_topics: tuple[str, ...] = ()
    odometry_topic: str | None = None
    odometry_frame: str | None = None
    base_frame: str | None = None
    no_odometry: bool = False
    keep_truncated: bool = False
    start_s: float = 0.0
    duration_s: float | None = None
    every: int = 1

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not 0 <= self.start_s < float("inf"):
            raise ArgumentError("start_s", "a time >= 0 s", self.start_s)
        if self.duration_s is not None and not self.duration_s > 0:
            raise ArgumentError("duration_s", "a time > 0 s", self.duration_s)
        if self.every < 1:
            raise ArgumentError("every", "a number >= 1", self.every)


LogSource: TypeAlias = str | Path | Log
"""What calls that read a log accept as one: where it is, or what `open_log` gives."""

_ALL = LogOptions()


def open_log(path: str | Path, options: LogOptions = _ALL) -> Log:
    """Open a log of any format that can be read, detected from its content: CARMEN, ROS 1 and ROS 2 bags, CSV.

    Parameters
    ----------
    path : str or Path
        The log: a file, or the folder of a ROS 2 bag.
    options : LogOptions
        What to read of it.

    Raises
    ------
    InputError
        There is no such file, or it is no log: names what it looks like; or an option does not fit its format.
    """
    from gridslam.io.log_format import LogFormat, detect_log_format
    from gridslam.io.selection import select

    form = detect_log_format(path)
    if form is LogFormat.BAG:
        from gridslam.io.bags.bag import BagLog  # only bags pay for the import of rosbags

        part = replace(options, scan_topics=())  # the reader takes care of the topics
        return select(BagLog(path, replace(options, start_s=0.0, duration_s=None, every=1)), part)
    if options.odometry_topic or options.odometry_frame or options.base_frame:
        raise InputError(path, f"topics and frames are chosen in bags alone, and this is a {form.value} log")
    if form is LogFormat.CSV:
        from gridslam.io.csv import CsvLog

        return select(CsvLog(path, keep_truncated=options.keep_truncated), options)
    from gridslam.io.carmen.reader import CarmenLog

    return select(CarmenLog(path, keep_truncated=options.keep_truncated), options)


def open_if_path(log: LogSource, options: LogOptions | None = None) -> Log:
    """Open the log at a path, and give one that is open as it is.

    Raises
    ------
    ArgumentError
        It is neither, or there are `options` for a log that is open already.
    InputError
        As `open_log`.
    """
    if isinstance(log, str | Path):
        return open_log(log, options or LogOptions())
    if not isinstance(log, Log):
        raise ArgumentError("log", "str, Path or a log as open_log gives it", describe(log))
    if options is not None:
        raise ArgumentError("options", "none for a log that is open already", options)
    return log
