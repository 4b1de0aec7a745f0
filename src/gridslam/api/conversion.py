"""From a log of one format to one of another."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import final

from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.io.csv import write_csv_log
from gridslam.io.log import LogOptions, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement

_FORMATS = {".csv": "csv", ".bag": "ros1", ".mcap": "mcap", ".db3": "ros2", "": "ros2"}
_NAMES = ".csv, .csv.gz, .csv.bz2, .bag, .mcap, .db3, or nothing (a folder)"
_PACKED = ".gz", ".bz2"


@final
@dataclass(frozen=True, slots=True)
class Conversion:
    """The written file.

    Attributes
    ----------
    out : Path
        The new log.
    format : str
        Its format: "csv", "ros1", "ros2" or "mcap".
    scans : int
        Scans written.
    log : LogStatistics
        What was met in the log that was read.
    """

    out: Path
    format: str
    scans: int
    log: LogStatistics


@checked
def convert_log(
    log: LogSource,
    out: str | Path,
    *,
    options: LogOptions | None = None,
    on_progress: Callable[[], None] = lambda: None,
) -> Conversion:
    """Write a log in another format; it appears under its name only once it is whole, and replaces a file there.

    A CSV has no scans without beams, and a bag no more than single precision.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    out : str or Path
        The new log; its suffix determines the format: .csv, .bag (ROS 1), .mcap, .db3 or none (the folder of a ROS 2
        bag). CSV is compressed where .gz or .bz2 follows.
    options : LogOptions, optional
        What to read of the log at a path.
    on_progress : callable
        Called after each scan.

    Raises
    ------
    ArgumentError
        The format is not known, `out` is the log itself, or `options` come with a log that is open already.
    InputError
        The log cannot be read, or contains data that the format cannot represent at all.
    OutputError
        The new log cannot be written.
    """
    target = Path(out)
    is_packed = target.suffix in _PACKED
    form = _FORMATS.get(Path(target.stem).suffix if is_packed else target.suffix)
    if form is None or (is_packed and form != "csv"):
        raise ArgumentError("out", f"a name for a log, which ends in {_NAMES}", repr(target.name))
    source = open_if_path(log, options)
    if target.exists() and target.samefile(source.path):
        raise ArgumentError("out", "a name other than the input log", str(out))
    scans = 0

    def measurements() -> Iterator[Measurement]:
        nonlocal scans
        for measurement in source:
            if form != "csv" or len(measurement.scan):
                scans += 1
                yield measurement
            on_progress()

    try:
        if form == "csv":
            write_csv_log(target, measurements())
        else:
            from gridslam.io.bags.writer import write_bag  # only bags pay for the import of rosbags

            write_bag(target, measurements())
    except ArgumentError as error:
        raise InputError(source.path, f"cannot be written as {form}: {error}") from None
    return Conversion(target, form, scans, source.statistics)
