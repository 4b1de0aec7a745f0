"""A part of a log: a time span, some of its sensors, every n-th scan, with or without odometry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, final

from gridslam.errors import InputError
from gridslam.io.bags.odometry_covariance import CovarianceSum
from gridslam.io.log import Log, LogOptions
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement

__all__ = ["SelectedLog", "select"]

_CHOOSING = "scan_topics", "no_odometry", "start_s", "duration_s", "every"


def select(log: Log, options: LogOptions) -> Log:
    """The part of a log that is asked for; the log itself where that is all of it."""
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
        counts, options = LogStatistics(selection=self._selection()), self._options
        self._counts = counts
        seen, since = Counter[str](), CovarianceSum()
        for measurement in self._in_span(counts):
            sensor, odometry = measurement.scan.sensor, since.add(measurement.odometry)
            seen[sensor] += 1
            unwanted = options.scan_topics and sensor not in options.scan_topics
            if unwanted or (seen[sensor] - 1) % options.every:
                continue
            since.given()
            chosen = Measurement(None if options.no_odometry else odometry, measurement.scan)
            counts.count(chosen)
            yield chosen
        missing = [name for name in options.scan_topics if name not in seen]
        if seen and missing:
            others = ", ".join(sorted(seen))
            raise InputError(self.path, f"expected scans of {', '.join(missing)}, got scans of {others} alone")
        if not seen:
            raise InputError(self.path, f"expected scans {self._span()}: the log lasts {self._lasts_s():.1f} s")

    def _in_span(self, counts: LogStatistics) -> Iterator[Measurement]:
        """Measurements of the chosen span of time."""
        start_s, duration_s = self._options.start_s, self._options.duration_s
        if not start_s and duration_s is None:
            yield from self._log
            return
        start_ns = round(start_s * 1e9)
        length_ns = None if duration_s is None else max(1, round(duration_s * 1e9))
        begun = False
        for elapsed_ns, measurement in _timed(self._log):
            into_ns = elapsed_ns - start_ns
            begun = begun or into_ns >= 0
            if not begun:
                continue
            if length_ns is not None:
                if into_ns >= length_ns:
                    return
                counts.span_read = max(counts.span_read, into_ns / length_ns)
            yield measurement

    def _selection(self) -> dict[str, Any]:
        """The options that leave something out."""
        values = {name: getattr(self._options, name) for name in _CHOOSING}
        return {name: value for name, value in values.items() if value != getattr(LogOptions(), name)}

    def _span(self) -> str:
        start_s, duration_s = self._options.start_s, self._options.duration_s
        until = "" if duration_s is None else f" and less than {start_s + duration_s:g} s"
        return f"{start_s:g} s or more{until} after the first"

    def _lasts_s(self) -> float:
        return self._log.statistics.duration_s


def _timed(log: Log) -> Iterator[tuple[int, Measurement]]:
    """Time since the log's first stamp, ns, and measurement; the first and the last have only their own stamps."""
    first_ns, before_ns = 0, 0
    here: Measurement | None = None
    for after in log:
        if here is None:
            first_ns = before_ns = after.scan.stamp_ns
        else:
            stamp_ns = here.scan.stamp_ns
            yield sorted((before_ns, stamp_ns, after.scan.stamp_ns))[1] - first_ns, here
            before_ns = stamp_ns
        here = after
    if here is not None:
        yield here.scan.stamp_ns - first_ns, here
