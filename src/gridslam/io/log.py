"""Logs of any format: the reader that a file needs, of the part that is asked for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from gridslam.arguments import describe
from gridslam.errors import ArgumentError, InputError
from gridslam.io.selection import Log, LogOptions, select

__all__ = ["Log", "LogOptions", "LogSource", "open_if_path", "open_log"]


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

    form = detect_log_format(path)
    if form is LogFormat.BAG:
        from gridslam.io.bags.bag import BagLog  # only bags pay for the import of rosbags

        part = replace(options, scan_topics=())  # the reader takes care of the topics
        return select(BagLog(path, replace(options, start_s=0.0, duration_s=None, every=1)), part)
    if options.odometry_topic or options.odometry_frame or options.base_frame:
        raise InputError(path, f"topics and frames are chosen in bags alone, and this is a {form.value} log")
    if form is LogFormat.CSV:
        from gridslam.io.csv.reader import CsvLog

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
