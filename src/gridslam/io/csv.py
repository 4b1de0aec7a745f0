"""Logs as tables of text, most with one scan a row; see docs/logs.md for the columns."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache, partial
from pathlib import Path
from typing import TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.angles import find_wrong_beam_angles, wrap
from gridslam.io.even_beams import find_step, find_time_increment, require_hits_within_limits
from gridslam.io.foreign_scans import ForeignRows, find_foreign_rows
from gridslam.io.log_statistics import LogStatistics, Mounting
from gridslam.io.measurement import FARTHEST_LASER_M, FARTHEST_M, Measurement
from gridslam.io.output import open_for_writing, write_atomically
from gridslam.io.tables import format_stamp_ns, parse_stamp_ns
from gridslam.io.text import TextSource, read_head
from gridslam.scan import LONGEST_SCAN_S
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

ODOMETRY = "odom_x_m", "odom_y_m", "odom_theta_rad"
"""Columns of the odometry; all three are empty where a scan has none."""

LASER = "laser_x_m", "laser_y_m", "laser_z_m", "laser_roll_rad", "laser_pitch_rad", "laser_yaw_rad"
"""Columns of the mounting: the laser seen from the base; empty is 0."""

REQUIRED = "stamp_s", "angle_min_rad", "angle_increment_rad", "ranges_m"
"""Columns without which there is no scan."""

COLUMNS = (
    "stamp_s",
    "sensor",
    "frame",
    *ODOMETRY,
    "odom_stamp_s",
    *LASER,
    "angle_min_rad",
    "angle_increment_rad",
    "time_increment_s",
    "range_min_m",
    "range_max_m",
    "ranges_m",
)
"""All columns, as they are written; they are read in any order."""

_OF_LASER = (
    "sensor",
    "frame",
    *LASER,
    "angle_min_rad",
    "angle_increment_rad",
    "time_increment_s",
    "range_min_m",
    "range_max_m",
)
"""Columns whose values are the same in all scans of one laser."""

_EVEN = 1e-9  # rad and s: beams that differ by less are evenly spread
_HEAD_BYTES = 1 << 16
_DEFAULTS = {"sensor": "laser", "frame": "laser", "range_max_m": "inf"} | dict.fromkeys((*LASER, "range_min_m"), "0")
_Cells: TypeAlias = Mapping[str, str]


def rotation_of_angles(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Rotation (3, 3) about the fixed axes x, y, z, one after the other, by angles in rad."""
    cr, cp, cy = np.cos([roll, pitch, yaw])
    sr, sp, sy = np.sin([roll, pitch, yaw])
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def angles_of_rotation(rotation: ArrayLike) -> tuple[float, float, float]:
    """Roll, pitch and yaw in rad of a rotation (3, 3); roll is 0 where the pitch is a right angle."""
    r = np.asarray(rotation, dtype=np.float64).tolist()
    level = math.hypot(r[0][0], r[1][0])
    pitch = math.atan2(-r[2][0], level)
    if level < 1e-9:
        return 0.0, pitch, math.atan2(-r[0][1], r[1][1])
    return math.atan2(r[2][1], r[2][2]), pitch, math.atan2(r[1][0], r[0][0])


@final
class CsvLog:
    """Scans in CSV (plain, gzip or bzip2), one row each; iterating yields a `Measurement` for each row.

    Tables of other programs, by `gridslam.io.foreign_scans`, are read, too.

    The first line names the columns, in any order; those that are not in `REQUIRED` may be missing, and their cells may
    be empty. Lines that begin with # are comments. Rows come in file order, whatever their stamps are.

    Parameters
    ----------
    path : str or Path
        The file.
    keep_truncated : bool
        Whether a file that is cut off gives the scans that are there instead of raising at its end.

    Attributes
    ----------
    statistics : LogStatistics
        What the latest iteration has met so far.

    Raises
    ------
    InputError
        At construction where there is no such file or it is empty; while iterating where a row is malformed (with its
        line and column), where the file is binary, damaged or cut off, or where it has no row.

    Notes
    -----
    `inf` and ranges at or above `range_max_m` are NO_RETURN; NaN, 0, negative ranges and those below `range_min_m` are
    INVALID. A last line without a line end counts as cut off: its last range may be incomplete.
    """

    def __init__(self, path: str | Path, *, keep_truncated: bool = False) -> None:
        """Check that there is a file; it is read by iterating."""
        self.path = Path(path)
        self.keep_truncated = keep_truncated
        self.statistics = LogStatistics(total_bytes=TextSource(path).total_bytes)

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        source = TextSource(self.path)
        statistics = self.statistics = LogStatistics(total_bytes=source.total_bytes)
        head = read_head(self.path, _HEAD_BYTES).decode("utf-8", "replace")
        try:
            rows = find_foreign_rows(head, statistics) or _Rows(statistics)
        except ValueError as error:
            raise InputError(self.path, str(error), 1) from None
        for lines in source:
            statistics.bytes_read = source.bytes_read
            if source.unterminated:
                break
            for line in lines:
                statistics.lines += 1
                yield from self._counted(partial(rows.parse, line))
        yield from self._counted(rows.end)
        statistics.bytes_read = source.bytes_read
        statistics.truncated = source.is_truncated or source.unterminated
        if statistics.truncated and not self.keep_truncated:
            what = "the compressed file" if source.is_truncated else "the last line has no line end: it"
            raise InputError(self.path, f"{what} is cut off; {statistics.scan_count} scans were read before")
        if statistics.scan_count == 0:
            raise InputError(self.path, "expected a row for each scan, got none")

    def _counted(self, take: Callable[[], Measurement | None]) -> Iterator[Measurement]:
        try:
            measurement = take()
        except ValueError as error:
            raise InputError(self.path, str(error), self.statistics.lines) from None
        if measurement is not None:
            self.statistics.count(measurement)
            yield measurement


@final
class _Rows(ForeignRows):
    """From lines to measurements: the header's names of the columns, and the lasers met so far."""

    def __init__(self, statistics: LogStatistics) -> None:
        self._statistics = statistics
        self._names: list[str] = []
        self._laser = lru_cache(maxsize=256)(self._make_laser)  # one that tilts is another one in each row

    def parse(self, line: str) -> Measurement | None:
        """Return the measurement of a row; None for the header, comments and blank lines."""
        text = line.rstrip("\r")
        if not self._names:
            text = text.removeprefix("\xef\xbb\xbf")  # the mark that some programs put before UTF-8
        if not text or text.isspace() or text.startswith("#"):
            return None
        if not self._names:
            self._names = _parse_header(text)
            return None
        words = _split(text)
        if len(words) != len(self._names):
            raise ValueError(f"expected {len(self._names)} cells as in the first line, got {len(words)}")
        cells = dict.fromkeys(COLUMNS, "") | dict(zip(self._names, words, strict=True))
        stamp_ns = _stamp(cells, "stamp_s")
        ranges = _parse_ranges(cells["ranges_m"])
        laser = self._laser(tuple(cells[name] for name in _OF_LASER), len(ranges))
        return Measurement(_odometry(cells, stamp_ns), laser(stamp_ns, ranges))

    def _make_laser(self, words: tuple[str, ...], beams: int) -> partial[LaserScan]:
        """`LaserScan.from_log` for the laser of these cells, which asks for a stamp and ranges."""
        texts = dict(zip(_OF_LASER, words, strict=True))
        cells = {name: _utf8(name, text.strip()) or _DEFAULTS.get(name, "") for name, text in texts.items()}
        start = _number(cells, "angle_min_rad")
        step = _number(cells, "angle_increment_rad")
        if problem := find_wrong_beam_angles(start, step, beams):
            raise ValueError(f"columns angle_min_rad, angle_increment_rad: {problem}")
        x, y, z, *angles = (
            _within(math.tau if name.endswith("_rad") else FARTHEST_LASER_M, cells, name) for name in LASER
        )
        mounting = np.eye(4)
        mounting[:3, :3] = rotation_of_angles(*angles)
        mounting[:3, 3] = x, y, z
        times = None
        if cells["time_increment_s"]:
            time = _number(cells, "time_increment_s")
            if not abs(time) * beams < LONGEST_SCAN_S:
                expected = f"expected a scan that takes less than {LONGEST_SCAN_S:g} s"
                raise ValueError(f"column time_increment_s: {expected}, got {beams} beams in steps of {time:g} s")
            times = time * np.arange(beams)
        yaw = angles_of_rotation(mounting[:3, :3])[2]
        self._statistics.mountings[cells["sensor"]] = Mounting(np.array([x, y, yaw]), "line")
        return partial(
            LaserScan.from_log,
            geometry=ScanGeometry(start + step * np.arange(beams), mounting),
            range_min_m=_number(cells, "range_min_m", 0.0),
            range_max_m=_number(cells, "range_max_m", 0.0, infinite=True),
            sensor=cells["sensor"],
            frame=cells["frame"],
            beam_times_s=times,
        )


def _parse_header(text: str) -> list[str]:
    names = [name.strip() for name in _split(text)]
    if len(names) < 2:
        raise ValueError(f"expected names of columns with commas between them, got {text[:60]!r}")
    unknown = [name for name in names if name not in COLUMNS]
    if unknown:
        raise ValueError(f"expected columns out of {', '.join(COLUMNS)}, got {unknown[0]!r}")
    missing = [name for name in REQUIRED if name not in names]
    if missing or len(set(names)) < len(names):
        problem = f"none named {missing[0]}" if missing else "one of them twice"
        raise ValueError(f"expected the columns {', '.join(REQUIRED)} and others, each once, got {problem}")
    return names


def _odometry(cells: _Cells, stamp_ns: int) -> Odometry | None:
    if not any(cells[name] for name in ODOMETRY):
        return None
    x, y, theta = (_within(FARTHEST_M, cells, name) for name in ODOMETRY)
    return Odometry.at(_stamp(cells, "odom_stamp_s") if cells["odom_stamp_s"] else stamp_ns, (x, y, wrap(theta)))


def _split(line: str) -> list[str]:
    """Return cells of a line; names of sensors may be quoted."""
    if '"' not in line:
        return line.split(",")
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error as error:
        raise ValueError(f"expected cells with commas between them: {error}") from None


def _stamp(cells: _Cells, column: str) -> int:
    try:
        return parse_stamp_ns(cells[column].strip())
    except ValueError as error:
        raise ValueError(f"column {column}: {error}") from None


def _number(cells: _Cells, column: str, least: float = -math.inf, *, infinite: bool = False) -> float:
    value = _float(cells[column])
    if value is None or not value >= least or (math.isinf(value) and not infinite):
        bound = "" if least == -math.inf else f" >= {least:g}"
        raise ValueError(f"column {column}: expected a number{bound}, got {cells[column]!r}")
    return value


def _within(limit: float, cells: _Cells, column: str) -> float:
    value = _number(cells, column)
    if not abs(value) <= limit:
        raise ValueError(f"column {column}: expected a number of at most {limit:g}, got {cells[column]!r}")
    return value


def _float(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _parse_ranges(text: str) -> list[float]:
    words = text.split()
    if not words:
        raise ValueError("column ranges_m: expected at least one range, got none")
    try:
        return [float(word) for word in words]
    except ValueError:
        place, word = next((place, word) for place, word in enumerate(words, 1) if _float(word) is None)
        expected = "expected numbers with blanks between them"
        raise ValueError(f"column ranges_m: {expected}, got {word!r} as {place}.") from None


def _utf8(column: str, text: str) -> str:
    """Return the text whose bytes were taken for Latin-1."""
    try:
        return text.encode("latin-1").decode("utf-8")
    except UnicodeDecodeError:
        raise ValueError(f"column {column}: expected text in UTF-8, got {text!r}") from None


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
        for odometry, scan in measurements:
            file.write(f"{','.join(_cells(odometry, scan))}\n".encode())


def _cells(odometry: Odometry | None, scan: LaserScan) -> Iterator[str]:
    """Yield the cells of a row."""
    yield format_stamp_ns(scan.stamp_ns)
    yield quote_name(scan.sensor)
    yield quote_name(scan.frame)
    yield from map(repr, odometry.pose.tolist()) if odometry else ("", "", "")
    yield format_stamp_ns(odometry.stamp_ns) if odometry and odometry.stamp_ns != scan.stamp_ns else ""
    yield _geometry(scan.geometry)
    yield "" if scan.beam_times_s is None else repr(find_time_increment(scan.beam_times_s, _EVEN))
    yield repr(float(scan.range_min_m))
    yield repr(float(scan.range_max_m))
    yield _format_ranges(scan)


def quote_name(text: str) -> str:
    """Return a name as a cell, quoted where it holds a comma or a quotation mark."""
    if "\n" in text or "\r" in text:
        raise ArgumentError("sensor, frame", "a name in one line", repr(text))
    return '"' + text.replace('"', '""') + '"' if "," in text or '"' in text else text


@lru_cache(maxsize=256)
def _geometry(geometry: ScanGeometry) -> str:
    """Return the cells of a mounting and of bearings."""
    transform = geometry.base_from_laser
    if not len(geometry.bearings):
        raise ArgumentError("bearings", "at least one beam", "none")
    bearings = find_step("bearings", geometry.bearings, _EVEN)
    values = [*transform[:3, 3].tolist(), *angles_of_rotation(transform[:3, :3]), *bearings]
    return ",".join(repr(value + 0.0) for value in values)  # no -0.0


def _format_ranges(scan: LaserScan) -> str:
    """Format ranges with blanks between them; `CsvLog` derives each beam's status from them."""
    require_hits_within_limits(scan)
    hit = scan.status == BeamStatus.HIT
    nothing = np.where(scan.status == BeamStatus.NO_RETURN, np.inf, np.nan)
    return " ".join(map(repr, np.where(hit, scan.ranges, nothing).tolist()))
