"""Streaming reader of scans in CSV, the format that people write from a table."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from gridslam.errors import InputError
from gridslam.geometry.angles import wrap
from gridslam.io.carmen.lines import LineError, parse_stamp_ns
from gridslam.io.csv.columns import COLUMNS, LASER, ODOMETRY, REQUIRED, angles_of_rotation, rotation_of_angles
from gridslam.io.log_statistics import LogStatistics, Mounting
from gridslam.io.measurement import FARTHEST_LASER_M, FARTHEST_M, Measurement
from gridslam.io.text import TextSource
from gridslam.scan import LONGEST_SCAN_S
from gridslam.types import FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["CsvLog"]

_MOST_LASERS = 256  # kept at a time: the mounting of a laser that tilts is another one in each row
_TURN_RAD = 6.3
_PLACE = {name: place for place, name in enumerate(COLUMNS)}
_STAMP, _ODOMETRY, _ODOMETRY_STAMP, _RANGES = (
    _PLACE["stamp_s"], slice(_PLACE[ODOMETRY[0]], _PLACE[ODOMETRY[-1]] + 1), _PLACE["odom_stamp_s"], _PLACE["ranges_m"],
)  # fmt: skip
_DEFAULTS = {"sensor": "laser", "frame": "laser", "range_max_m": "inf"} | dict.fromkeys((*LASER, "range_min_m"), "0")


class _CellError(ValueError):
    """A cell cannot be read: names its column, what was expected and what was found."""

    def __init__(self, column: str, expected: str, got: str) -> None:
        super().__init__(f"column {column}: expected {expected}, got {got}")


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Laser:
    """Properties of the laser that scans with equal cells share."""

    sensor: str
    frame: str
    geometry: ScanGeometry
    beam_times_s: FloatArray | None
    range_min_m: float
    range_max_m: float


@final
class CsvLog:
    """Scans in CSV (plain, gzip or bzip2), one row each; iterating yields a `Measurement` for each row.

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
        rows = _Rows(statistics)
        for lines in source:
            statistics.bytes_read = source.bytes_read
            if source.unterminated:
                break
            for line in lines:
                statistics.lines += 1
                try:
                    measurement = rows.parse(line)
                except ValueError as error:
                    raise InputError(self.path, str(error), statistics.lines) from None
                if measurement is not None:
                    statistics.count(measurement)
                    yield measurement
        statistics.bytes_read = source.bytes_read
        if source.is_truncated or source.unterminated:
            self._end_early("the compressed file" if source.is_truncated else "the last line has no line end: it")
        if statistics.scan_count == 0:
            raise InputError(self.path, "expected a row for each scan, got none")

    def _end_early(self, what: str) -> None:
        self.statistics.truncated = True
        if not self.keep_truncated:
            raise InputError(self.path, f"{what} is cut off; {self.statistics.scan_count} scans were read before")


@final
class _Rows:
    """From lines to measurements: the header's order of columns, and the lasers met so far."""

    def __init__(self, statistics: LogStatistics) -> None:
        self._statistics = statistics
        self._order: list[int] = []  # where each of COLUMNS stands in a row; past its end where there is none
        self._width = 0
        self._lasers: dict[tuple[str, ...], _Laser] = {}

    def parse(self, line: str) -> Measurement | None:
        """The measurement of a row; None for the header, comments and blank lines."""
        text = line.rstrip("\r")
        if not self._order:
            text = text.removeprefix("\xef\xbb\xbf")  # the mark that some programs put before UTF-8
        if not text or text.isspace():
            return None
        if text.startswith("#"):
            self._statistics.comments += 1
            return None
        if not self._order:
            self._take_header(text)
            return None
        cells = _split(text)
        if len(cells) != self._width:
            raise ValueError(f"expected {self._width} cells as in the first line, got {len(cells)}")
        cells.append("")
        cells = [cells[place] for place in self._order]
        stamp_ns = _stamp("stamp_s", cells[_STAMP])
        return Measurement(self._odometry(cells, stamp_ns), self._scan(cells, stamp_ns))

    def _take_header(self, text: str) -> None:
        names = [name.strip() for name in _split(text)]
        if len(names) < 2:
            raise ValueError(f"expected names of columns with commas between them, got {text[:60]!r}")
        unknown = [name for name in names if name not in _PLACE]
        if unknown:
            raise ValueError(f"expected columns out of {', '.join(COLUMNS)}, got {unknown[0]!r}")
        missing = [name for name in REQUIRED if name not in names]
        if missing or len(set(names)) < len(names):
            problem = f"none named {missing[0]}" if missing else "one of them twice"
            raise ValueError(f"expected the columns {', '.join(REQUIRED)} and others, each once, got {problem}")
        self._width = len(names)
        self._order = [names.index(name) if name in names else self._width for name in COLUMNS]

    def _odometry(self, cells: Sequence[str], stamp_ns: int) -> Odometry | None:
        x, y, theta = texts = cells[_ODOMETRY]
        if not (x or y or theta):
            return None
        pose = np.array([_within(FARTHEST_M, name, text) for name, text in zip(ODOMETRY, texts, strict=True)])
        pose[2] = wrap(pose[2])
        pose.flags.writeable = False
        own = cells[_ODOMETRY_STAMP]
        return Odometry(_stamp("odom_stamp_s", own) if own else stamp_ns, pose)

    def _scan(self, cells: Sequence[str], stamp_ns: int) -> LaserScan:
        ranges = _ranges(cells[_RANGES])
        key = cells[1], cells[2], *cells[_ODOMETRY_STAMP + 1 : _RANGES], str(len(ranges))
        laser = self._lasers.get(key)
        if laser is None:
            if len(self._lasers) >= _MOST_LASERS:
                self._lasers.clear()
            laser = self._lasers[key] = _laser(dict(zip(COLUMNS, cells, strict=True)), len(ranges))
            yaw = angles_of_rotation(laser.geometry.base_from_laser[:3, :3])[2]
            self._statistics.mountings[laser.sensor] = Mounting(np.append(laser.geometry.origin, yaw), "line")
        return LaserScan.from_ranges(
            stamp_ns, ranges, laser.geometry, range_min_m=laser.range_min_m, range_max_m=laser.range_max_m,
            sensor=laser.sensor, frame=laser.frame, beam_times_s=laser.beam_times_s,
        )  # fmt: skip


def _split(line: str) -> list[str]:
    """Cells of a line; names of sensors may be quoted."""
    if '"' not in line:
        return line.split(",")
    try:
        return next(csv.reader([line], strict=True))
    except csv.Error as error:
        raise ValueError(f"expected cells with commas between them: {error}") from None


def _stamp(column: str, text: str) -> int:
    try:
        return parse_stamp_ns(text.strip())
    except LineError as error:
        raise ValueError(f"column {column}: {error}") from None


def _number(column: str, text: str, least: float = -math.inf, *, infinite: bool = False) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not value >= least or (math.isinf(value) and not infinite):
        bound = "" if least == -math.inf else f" >= {least:g}"
        raise _CellError(column, f"a number{bound}", repr(text))
    return value


def _within(limit: float, column: str, text: str) -> float:
    value = _number(column, text)
    if not abs(value) <= limit:
        raise _CellError(column, f"a number of at most {limit:g}", repr(text))
    return value


def _ranges(text: str) -> list[float]:
    words = text.split()
    try:
        ranges = [float(word) for word in words]
    except ValueError:
        place = next(place for place, word in enumerate(words, 1) if not _is_number(word))
        raise _CellError("ranges_m", "numbers with blanks between them", f"{words[place - 1]!r} as {place}.") from None
    if not ranges:
        raise _CellError("ranges_m", "at least one range", "none")
    return ranges


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _utf8(column: str, text: str) -> str:
    """The text whose bytes were taken for Latin-1."""
    try:
        return text.encode("latin-1").decode("utf-8")
    except UnicodeDecodeError:
        raise _CellError(column, "text in UTF-8", repr(text)) from None


def _laser(cells: dict[str, str], beams: int) -> _Laser:
    """Laser properties of a row."""
    texts = {name: _utf8(name, text.strip()) or _DEFAULTS.get(name, "") for name, text in cells.items()}
    start, step = (_number(name, texts[name]) for name in ("angle_min_rad", "angle_increment_rad"))
    if abs(start) > 2 * _TURN_RAD or abs(step) * (beams - 1) > _TURN_RAD + abs(step) or (step == 0 and beams > 1):
        got = f"{beams} beams from {start:g} in steps of {step:g}"
        raise _CellError("angle_increment_rad", "beams within one turn, in radians", got)
    x, y, z, *angles = (_within(FARTHEST_LASER_M, name, texts[name]) for name in LASER)
    mounting = np.eye(4)
    mounting[:3, :3] = rotation_of_angles(*angles)
    mounting[:3, 3] = x, y, z
    time = _number("time_increment_s", texts["time_increment_s"] or "0")
    if not abs(time) * beams < LONGEST_SCAN_S:
        got = f"{beams} beams in steps of {time:g} s"
        raise _CellError("time_increment_s", f"a scan that takes less than {LONGEST_SCAN_S:g} s", got)
    times: FloatArray = time * np.arange(beams, dtype=np.float64)
    return _Laser(
        sensor=texts["sensor"],
        frame=texts["frame"],
        geometry=ScanGeometry(start + step * np.arange(beams), mounting),
        beam_times_s=times if texts["time_increment_s"] else None,
        range_min_m=_number("range_min_m", texts["range_min_m"], 0.0),
        range_max_m=_number("range_max_m", texts["range_max_m"], 0.0, infinite=True),
    )
