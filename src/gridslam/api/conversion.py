"""From a log of one format to one of another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import final

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.io.csv import write_csv_log
from gridslam.io.log import Log, LogOptions, LogSource, open_if_path
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.io.output import write_atomically
from gridslam.io.trajectories import write_tum
from gridslam.types import BeamStatus, Odometry, Trajectory


class OutFormat(Enum):
    """Formats that a log can be written in."""

    CSV = "csv"
    TUM = "tum"
    ROS1 = "ros1"
    ROS2 = "ros2"
    MCAP = "mcap"


_BY_SUFFIX = {
    ".csv": OutFormat.CSV,
    ".tum": OutFormat.TUM,
    ".bag": OutFormat.ROS1,
    ".db3": OutFormat.ROS2,
    "": OutFormat.ROS2,
    ".mcap": OutFormat.MCAP,
}
_NAMES = ".csv, .csv.gz, .csv.bz2, .tum, .bag, .mcap, .db3, or nothing (a folder)"
_PACKED = ".gz", ".bz2"


@final
@dataclass(frozen=True, slots=True)
class Conversion:
    """The written file, and the data that its format cannot represent.

    Attributes
    ----------
    out : Path
        The new log.
    format : OutFormat
        Its format.
    scans : int
        Scans written; for TUM poses.
    lost : dict of str to int
        What the format cannot hold, by name, and in how many scans there was such.
    log : LogStatistics
        What was met in the log that was read.
    """

    out: Path
    format: OutFormat
    scans: int
    lost: dict[str, int]
    log: LogStatistics


def infer_format(out: str | Path, to: str | None = None) -> OutFormat:
    """Return the format of the new log: by the suffix of its name, or `to`.

    Raises ArgumentError if the name has no known suffix, or that of a bag of another kind than `to`.
    """
    path = Path(out)
    packed = path.suffix in _PACKED
    named = _BY_SUFFIX.get(Path(path.stem).suffix if packed else path.suffix)
    if to is not None and to not in {form.value for form in OutFormat}:
        raise ArgumentError("to", ", ".join(form.value for form in OutFormat), repr(to))
    form = named if to is None else OutFormat(to)
    if form is OutFormat.CSV:
        return form
    kinds = OutFormat.ROS1, OutFormat.MCAP  # whose writer uses the suffix
    if form is None or packed or (form is not named and (form in kinds or (form is OutFormat.ROS2 and named in kinds))):
        what = "a log" if form is None else f"a log in the format {form.value}"
        raise ArgumentError("out", f"a name for {what}, which ends in {_NAMES}", repr(path.name))
    return form


@checked
def convert_log(
    log: LogSource,
    out: str | Path,
    *,
    to: str | None = None,
    options: LogOptions | None = None,
    on_progress: Callable[[], None] = lambda: None,
) -> Conversion:
    """Write a log in another format; it appears under its name only once it is whole, and replaces a file there.

    Parameters
    ----------
    log : str, Path or Log
        The log, of any format that `open_log` knows.
    out : str or Path
        The new log; its suffix determines the format: .csv, .tum (the odometry alone), .bag (ROS 1), .mcap, .db3 or
        none (the folder of a ROS 2 bag). CSV is compressed where .gz or .bz2 follows.
    to : str, optional
        The format where the suffix does not determine it: "csv", "tum", "ros1", "ros2" or "mcap".
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
    form = infer_format(out, to)
    source = open_if_path(log, options)
    target = Path(out)
    if target.exists() and target.samefile(source.path):
        raise ArgumentError("out", "a name other than the input log", str(out))
    lost: Counter[str] = Counter()
    scans = 0

    def counted(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        nonlocal scans
        for measurement in measurements:
            scans += 1
            yield measurement
            on_progress()

    try:
        _write(form, target, source, lost, counted)
    except ArgumentError as error:
        raise InputError(source.path, f"cannot be written as {form.value}: {error}") from None
    return Conversion(target, form, scans, {what: count for what, count in lost.items() if count}, source.statistics)


def _write(
    form: OutFormat,
    target: Path,
    log: Log,
    lost: Counter[str],
    counted: Callable[[Iterable[Measurement]], Iterator[Measurement]],
) -> None:
    if form is OutFormat.CSV:
        write_csv_log(target, counted(_with_beams(log, lost)))
    elif form is OutFormat.TUM:
        _write_odometry(target, log.path, counted(_with_odometry(log, lost)))
    else:
        from gridslam.io.bags.writer import write_bag  # only bags pay for the import of rosbags

        write_bag(target, counted(_single_precision(log, lost)))


def _with_beams(measurements: Iterable[Measurement], lost: Counter[str]) -> Iterator[Measurement]:
    """Yield the measurements whose scans have any beam."""
    for measurement in measurements:
        if len(measurement.scan):
            yield measurement
        else:
            lost["scans without beams"] += 1


def _with_odometry(measurements: Iterable[Measurement], lost: Counter[str]) -> Iterator[Measurement]:
    """Return the odometry readings, each once, which a trajectory can represent."""
    before: Odometry | None = None
    for measurement in measurements:
        odometry = measurement.odometry
        lost["scans"] += 1
        lost["scans without odometry"] += odometry is None
        if odometry is not None and odometry is not before:
            yield measurement
        before = odometry


def _write_odometry(target: Path, source: Path, measurements: Iterable[Measurement]) -> None:
    known = [measurement.odometry for measurement in measurements if measurement.odometry is not None]
    if not known:
        raise InputError(source, "cannot be written as tum: it has no odometry")
    stamps_ns = np.array([odometry.stamp_ns for odometry in known], dtype=np.int64)
    with write_atomically(target) as aside:
        write_tum(aside, Trajectory(stamps_ns, np.array([odometry.pose for odometry in known])))


def _single_precision(measurements: Iterable[Measurement], lost: Counter[str]) -> Iterator[Measurement]:
    """Yield the measurements as they are; counts the scans whose ranges will be rounded."""
    for measurement in measurements:
        scan = measurement.scan
        hits = scan.ranges[scan.status == BeamStatus.HIT]
        lost["more than single precision of ranges"] += bool((hits != hits.astype(np.float32)).any())
        yield measurement
