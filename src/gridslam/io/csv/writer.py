"""Writer of scans in CSV, one row each; see docs/logs.md for the columns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.io.carmen.lines import format_stamp_ns
from gridslam.io.csv.columns import COLUMNS, angles_of_rotation
from gridslam.io.measurement import Measurement
from gridslam.io.output import open_for_writing, write_atomically
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["write_csv_log"]

_MOST_GEOMETRIES = 256


def write_csv_log(path: str | Path, measurements: Iterable[Measurement]) -> None:
    """Write a log that `CsvLog` reads back: stamps, hits, statuses and odometry exactly, directions to 1e-12.

    Of beams that hit nothing only the status is kept: NO_RETURN is `inf`, INVALID is `nan`. The file appears under its
    name only once it is whole.

    Parameters
    ----------
    path : str or Path
        Compressed where its suffix is .gz or .bz2.
    measurements : iterable of Measurement
        In the order in which they are to stand in the log; may be a generator.

    Raises
    ------
    ArgumentError
        For data that the columns cannot represent: beams that are not evenly spread in angle or in time, hits outside
        the range limits.
    OutputError
        Where the file cannot be written.
    """
    with write_atomically(path) as aside, open_for_writing(aside, Path(path).suffix) as file:
        file.write(f"{','.join(COLUMNS)}\n".encode())
        geometries: dict[int, tuple[ScanGeometry, str]] = {}
        for odometry, scan in measurements:
            if id(scan.geometry) not in geometries:
                if len(geometries) >= _MOST_GEOMETRIES:
                    geometries.clear()
                geometries[id(scan.geometry)] = scan.geometry, _geometry(scan.geometry)
            cells = _cells(odometry, scan, geometries[id(scan.geometry)][1])
            file.write(f"{','.join(cells)}\n".encode())


def _cells(odometry: Odometry | None, scan: LaserScan, geometry: str) -> Iterator[str]:
    """The cells of a row; `geometry` has those of the mounting and of the bearings."""
    yield format_stamp_ns(scan.stamp_ns)
    yield _name(scan.sensor)
    yield _name(scan.frame)
    yield from map(repr, odometry.pose.tolist()) if odometry else ("", "", "")
    yield format_stamp_ns(odometry.stamp_ns) if odometry and odometry.stamp_ns != scan.stamp_ns else ""
    yield geometry
    yield "" if scan.beam_times_s is None else repr(_time_increment_s(scan.beam_times_s))
    yield repr(float(scan.range_min_m))
    yield repr(float(scan.range_max_m))
    yield _ranges(scan)


def _name(text: str) -> str:
    if "\n" in text or "\r" in text:
        raise ArgumentError("sensor, frame", "a name in one line", repr(text))
    return '"' + text.replace('"', '""') + '"' if "," in text or '"' in text else text


def _geometry(geometry: ScanGeometry) -> str:
    """The cells of a mounting and of bearings."""
    transform = geometry.base_from_laser
    values = [*transform[:3, 3].tolist(), *angles_of_rotation(transform[:3, :3]), *_even("bearings", geometry.bearings)]
    return ",".join(repr(value + 0.0) for value in values)  # no -0.0


def _even(name: str, values: FloatArray) -> tuple[float, float]:
    """First value and step of evenly spread ones."""
    if not len(values):
        raise ArgumentError(name, "at least one beam", "none")
    steps = max(len(values) - 1, 1)
    step = float(values[-1] - values[0]) / steps
    if not (abs(values - values[0] - step * np.arange(len(values))) <= 1e-9).all():
        raise ArgumentError(name, "evenly spread beams", values)
    return float(values[0]), step


def _time_increment_s(times: FloatArray) -> float:
    first, step = _even("beam_times_s", times)
    if abs(first) > 1e-9:
        raise ArgumentError("beam_times_s", "a first beam at the scan's stamp", first)
    return step


def _ranges(scan: LaserScan) -> str:
    """Ranges with blanks between them: what `CsvLog` decides each beam's status by."""
    ranges, hit = scan.ranges, scan.status == BeamStatus.HIT
    hits = ranges[hit]
    if not ((hits > 0) & (hits >= scan.range_min_m) & (hits < scan.range_max_m)).all():
        limits = f"hits from {scan.range_min_m:g} m on and below {scan.range_max_m:g} m"
        raise ArgumentError("ranges", limits, (float(hits.min()), float(hits.max())))
    nothing = np.where(scan.status == BeamStatus.NO_RETURN, np.inf, np.nan)
    return " ".join(map(repr, np.where(hit, ranges, nothing).tolist()))
