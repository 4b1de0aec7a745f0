"""The interface of logs, and the selection of a part: time span, sensors, every n-th scan, use of the odometry."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import dropwhile
from pathlib import Path
from typing import Any, Protocol, final, runtime_checkable

from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement

_MOST_S = 9e9  # 285 years: in ns less than 64 bits hold
_CHOOSING = "scan_topics", "no_odometry", "start_s", "duration_s", "every"


@runtime_checkable
class Log(Protocol):
    """A stream of measurements that can be read again from its start."""

    @property
    def path(self) -> Path:
        """The file or folder."""
        ...

    @property
    def statistics(self) -> LogStatistics:
        """Statistics of the latest iteration so far."""
        ...

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start; raises InputError where it cannot be read on."""
        ...


@final
@checked
@dataclass(frozen=True, slots=True)
class LogOptions:
    """The part of a log to read, and how to read it.

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
    start_s : float, [0, 9e9]
        Skip the scans less than this many seconds after the first.
    duration_s : float or None, (0, 9e9]
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
        if not self.start_s >= 0:
            raise ArgumentError("start_s", "a time >= 0 s", self.start_s)
        if self.duration_s is not None and not self.duration_s > 0:
            raise ArgumentError("duration_s", "a time > 0 s", self.duration_s)
        for name in ("start_s", "duration_s"):
            if (getattr(self, name) or 0) > _MOST_S:
                raise ArgumentError(name, f"a time of at most {_MOST_S:g} s", getattr(self, name))
        if self.every < 1:
            raise ArgumentError("every", "a number >= 1", self.every)

    def to_dict(self) -> dict[str, Any]:
        """Return all options as JSON values."""
        return {**asdict(self), "scan_topics": list(self.scan_topics)}


def select(log: Log, options: LogOptions) -> Log:
    """Return the part of a log that is asked for; the log itself where that is all of it."""
    part = options.scan_topics or options.no_odometry or options.start_s or options.duration_s or options.every > 1
    return SelectedLog(log, options) if part else log


@final
class SelectedLog:
    """A part of another log; iterating reads that one, and no farther than is needed.

    The part is what stands together in the log: it begins with the first scan that comes `start_s` after the log's
    first stamp, and ends ahead of the first one that comes `duration_s` later still, whatever stamps go back in
    between. A single wrong stamp has no effect: the time of a scan is the median of its stamp and its
    neighbours'. Of the remaining scans every n-th of each sensor is used.

    Parameters
    ----------
    log : Log
        What to choose from.
    options : LogOptions
        `scan_topics` are names of sensors here; `keep_truncated` and what concerns bags is for the log's own reader.

    Raises
    ------
    InputError
        While iterating, where nothing is chosen, and for what `log` itself raises.
    """

    def __init__(self, log: Log, options: LogOptions) -> None:
        """Nothing is read before the iteration."""
        self._log = log
        self._options = options
        self._counts = LogStatistics(selection=self._selection())

    @property
    def path(self) -> Path:
        """The file or folder."""
        return self._log.path

    @property
    def statistics(self) -> LogStatistics:
        """Of the file, and of the chosen scans alone."""
        return self._log.statistics.of_scans(self._counts)

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        options = self._options
        counts = self._counts = LogStatistics(selection=self._selection())
        seen = Counter[str]()
        for measurement in self._in_span(counts):
            sensor = measurement.scan.sensor
            seen[sensor] += 1
            unwanted = options.scan_topics and sensor not in options.scan_topics
            if unwanted or (seen[sensor] - 1) % options.every:
                continue
            chosen = Measurement(None if options.no_odometry else measurement.odometry, measurement.scan)
            counts.count(chosen)
            yield chosen
        missing = [name for name in options.scan_topics if name not in seen]
        if seen and missing:
            others = ", ".join(sorted(seen))
            raise InputError(self.path, f"expected scans of {', '.join(missing)}, got scans of {others} alone")
        if not seen:
            until = "" if options.duration_s is None else f" and less than {options.start_s + options.duration_s:g} s"
            span = f"{options.start_s:g} s or more{until} after the first"
            raise InputError(self.path, f"expected scans {span}: the log lasts {self._log.statistics.duration_s:.1f} s")

    def _in_span(self, counts: LogStatistics) -> Iterator[Measurement]:
        """Yield measurements of the chosen span of time."""
        start_ns = round(self._options.start_s * 1e9)
        duration_s = self._options.duration_s
        length_ns = math.inf if duration_s is None else max(1, round(duration_s * 1e9))
        chosen = dropwhile(lambda timed: timed[0] < start_ns, _timed(self._log))
        for elapsed_ns, measurement in chosen:
            into_ns = elapsed_ns - start_ns
            if into_ns >= length_ns:
                return
            counts.span_read = max(counts.span_read, into_ns / length_ns)
            yield measurement

    def _selection(self) -> dict[str, Any]:
        """Return the options that leave something out."""
        values = {name: getattr(self._options, name) for name in _CHOOSING}
        return {name: value for name, value in values.items() if value != getattr(LogOptions(), name)}


def _timed(log: Log) -> Iterator[tuple[int, Measurement]]:
    """Time since the log's first stamp, ns, and measurement; the first and the last have only their own stamps."""
    measurements = iter(log)
    here = next(measurements, None)
    if here is None:
        return
    first_ns = before_ns = here.scan.stamp_ns
    for after in measurements:
        stamp_ns = here.scan.stamp_ns
        yield sorted((before_ns, stamp_ns, after.scan.stamp_ns))[1] - first_ns, here
        before_ns = stamp_ns
        here = after
    yield here.scan.stamp_ns - first_ns, here
