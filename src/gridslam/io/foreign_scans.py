"""Scans in tables that other programs write: of ROS's `echo`, and rows of an angle and a distance each.

Both come without odometry and mounting. A table is known by its header, or by the names in each row
(``theta: 1.5 Dist: 300``, as of the RPLIDAR SDK's example).
"""

from __future__ import annotations

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import final

import numpy as np

from gridslam.geometry.angles import find_wrong_beam_angles
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.io.tables import parse_stamp_ns, parse_whole_ns
from gridslam.types import FloatArray, LaserScan, ScanGeometry

_ROSTOPIC = "%time,"
_STAMP = "header.stamp"
_NUMBERS = "angle_min", "angle_max", "angle_increment", "time_increment", "range_min", "range_max"
_ECHO = re.compile(r"\d+,\d{1,9},[^,]*(?:,[-+.\deinfa]+){8,}")  # the first row of `ros2 topic echo --csv`
_DEGREES = re.compile("â?°|\ufffd")  # in UTF-8 read as Latin-1, or the other way round
_ECHOED = "sec", "nanosec", "frame_id", *_NUMBERS[:4], "scan_time", *_NUMBERS[4:]
_OFF_BY_ONE = 1.5  # beams by which drivers state the last angle wrongly
_KEY = re.compile(r"([A-Za-z]\w*):\s*")
_SYNC = re.compile(r"^S\s+(?=[A-Za-z]\w*:)")  # of a beam that begins a turn
_ANGLE = re.compile(r"(?:angle|theta|bearing|azimuth)(?:[ _(\[]*(deg|rad)\w*[)\]]?)?")
_DISTANCE = re.compile(r"(?:dist|distance|range|radius|r)(?:[ _(\[]*(mm|cm|m|in|ft)[)\]]?)?")
_TIME = re.compile(r"(?:t|time|stamp|timestamp)(?:[ _(\[]*(ns|us|ms|s)[)\]]?)?")
_OF_A_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0, "in": 1 / 0.0254, "ft": 1 / 0.3048}
_OF_A_SECOND = {"s": 0, "ms": 3, "us": 6, "ns": 9}  # powers of ten
_SINCE_1970 = {13: "ms", 16: "us", 17: "ns", 18: "ns", 19: "ns"}  # by the number of digits
_OF_RPLIDAR = "rplidar", "theta: "  # in the head of what its SDK writes, in any case; its angles count clockwise
_MOST_RAD = 7.0  # of an angle without unit: more are degrees
_MOST_M = 100.0  # of the median of ranges without unit: more are millimetres
_BACK = 0.5  # of what a scan has swept, from which on the angle starts over: some jitter
_MOST_BEAMS = 100_000
_PERIOD_NS = 100_000_000  # of scans without stamps


class ForeignRows(ABC):
    """Converts the lines of a table to measurements, one after the other."""

    @abstractmethod
    def parse(self, line: str) -> Measurement | None:
        """Take the next line; return a scan that is complete, or None. Raises ValueError for a malformed line."""

    def end(self) -> Measurement | None:
        """Return the scan that the last line completes, or None. Raises ValueError where it is none."""
        return None


def is_foreign_table(head: str) -> bool:
    """Return whether a text that begins with `head` is such a table."""
    return _find_header(head) != "" or _ECHO.match(head) is not None


def find_foreign_rows(head: str, statistics: LogStatistics) -> ForeignRows | None:
    """Return a converter for a table that begins with `head`; None where the table is of another kind.

    Raises ValueError where it is one, without the columns of a scan.
    """
    if _ECHO.match(head):
        return _EchoRows()
    header = _find_header(head)
    if not header:
        return None
    if header.startswith(_ROSTOPIC):
        return _RostopicRows(header)
    return _PointRows(_split(header), statistics, clockwise=any(sign in head.lower() for sign in _OF_RPLIDAR))


def _find_header(head: str) -> str:
    """The names of a table's columns; empty where it is none. They may stand in a comment ahead of the first row."""
    for line in head.split("\n"):
        text = line.strip().removeprefix("\ufeff")
        if text.startswith(_ROSTOPIC) and "angle_min" in text:
            return text
        names = _lower(" ".join(_KEY.findall(text)) or text.lstrip("# "))
        words = _split(names)
        if _match(_ANGLE, words) and _match(_DISTANCE, words):
            return names
        if text and not text.startswith("#"):
            break
    return ""


def _lower(text: str) -> str:
    return _DEGREES.sub("deg", text.lower())


def _split(text: str) -> list[str]:
    """Words of a row, between semicolons (then a comma is a decimal one), or commas or tabs, or blanks."""
    plain = text.replace('"', "").strip()
    if ";" in plain:
        return [word.strip().replace(",", ".") for word in plain.split(";")]
    return [word.strip() for word in re.split("[,\t]", plain)] if re.search("[,\t]", plain) else plain.split()


def _match(pattern: re.Pattern[str], names: Sequence[str]) -> tuple[int, str] | None:
    """Return the first column of a kind: its place, and its unit, empty where its name has none."""
    for place, name in enumerate(names):
        if found := pattern.fullmatch(name):
            return place, found[1] or ""
    return None


def _number(words: Sequence[str], place: int, name: str) -> float:
    try:
        return float(words[place])
    except ValueError:
        raise ValueError(f"column {name}: expected a number, got {words[place]!r:.60}") from None


@final
class _RostopicRows(ForeignRows):
    """`rostopic echo -p /scan`: a scan in each row."""

    def __init__(self, header: str) -> None:
        self._is_header = True
        self._names = [name.removeprefix("field.") for name in header.split(",")]
        self._places = {name: place for place, name in enumerate(self._names)}
        wanted = [_STAMP, *_NUMBERS, "ranges0"]
        if missing := [name for name in wanted if name not in self._places]:
            raise ValueError(f"expected the columns {', '.join(wanted)} of a LaserScan, got none named {missing[0]}")
        self._ranges = [place for place, name in enumerate(self._names) if re.fullmatch(r"ranges\d+", name)]

    def parse(self, line: str) -> Measurement | None:
        if self._is_header or not line.strip():
            self._is_header = self._is_header and not line.strip()
            return None
        words = line.rstrip("\r").split(",")
        if len(words) != len(self._names):
            raise ValueError(f"expected {len(self._names)} cells as in the first line, got {len(words)}")
        numbers = {name: _number(words, self._places[name], name) for name in _NUMBERS}
        stamp_ns = parse_whole_ns(words[self._places[_STAMP]]) or parse_whole_ns(words[0])
        return _scan(stamp_ns, numbers, [_number(words, place, self._names[place]) for place in self._ranges])


@final
class _EchoRows(ForeignRows):
    """`ros2 topic echo --csv /scan`: a LaserScan in each row, its fields in their order and without names."""

    def parse(self, line: str) -> Measurement | None:
        words = line.rstrip("\r").split(",")
        if not line.strip():
            return None
        if "..." in words:
            raise ValueError("expected whole scans, got some cut off by '...': ros2 topic echo --csv --full-length")
        if not words[-1]:
            words.pop()  # intensities that there are not
        if len(words) < len(_ECHOED):
            raise ValueError(f"expected a LaserScan in each row ({','.join(_ECHOED)},...), got {len(words)} cells")
        numbers = {name: _number(words, _ECHOED.index(name), name) for name in _NUMBERS}
        values = [_number(words, place, "ranges, intensities") for place in range(len(_ECHOED), len(words))]
        sweep = numbers["angle_max"] - numbers["angle_min"]
        beams = sweep / numbers["angle_increment"] + 1 if numbers["angle_increment"] else math.inf
        counts = (len(values) // parts for parts in (1, 2) if len(values) % parts == 0)
        ranges = next((n for n in counts if n >= 2 and abs(n - beams) < _OFF_BY_ONE), 0)
        if not ranges:
            raise ValueError(
                f"expected {beams:.0f} ranges by the angles, and as many intensities or none, got {len(values)}"
            )
        stamp_ns = parse_whole_ns(words[0]) * 10**9 + parse_whole_ns(words[1])
        return _scan(stamp_ns, numbers, values[:ranges])


def _scan(stamp_ns: int, numbers: Mapping[str, float], ranges: list[float]) -> Measurement:
    """Make a scan of the fields of a LaserScan."""
    start, end, step = (numbers[f"angle_{name}"] for name in ("min", "max", "increment"))
    if problem := find_wrong_beam_angles(start, step, len(ranges), end):
        raise ValueError(problem)
    scan = LaserScan.from_ros(
        stamp_ns,
        ranges,
        angle_min=start,
        angle_increment=step,
        range_min=numbers["range_min"],
        range_max=numbers["range_max"],
        time_increment=numbers["time_increment"],
        geometry=_geometry(start, step, len(ranges)),
    )
    return Measurement(None, scan)


@lru_cache(maxsize=64)
def _geometry(start: float, step: float, beams: int) -> ScanGeometry:
    return ScanGeometry(start + step * np.arange(beams))


@final
class _PointRows(ForeignRows):
    """A beam in each row: an angle, a distance, and mostly a time.

    A scan ends where the angle starts over.

    Units are those that the names state. Without, angles are degrees where one is beyond 7, and distances millimetres
    where their median in the first scan is beyond 100. Angles count counter-clockwise unless `clockwise`.
    """

    def __init__(self, names: list[str], statistics: LogStatistics, *, clockwise: bool) -> None:
        self._names = names
        self._angle = _match(_ANGLE, names) or (0, "")
        self._distance = _match(_DISTANCE, names) or (0, "")
        self._time = _match(_TIME, names)
        self._statistics = statistics
        self._direction = -1.0 if clockwise else 1.0
        self._is_header = True
        self._beams: list[tuple[float, float]] = []
        self._stamp_ns = 0
        self._scans = 0
        self._units: tuple[float, float] | None = None  # of a radian and of a metre
        self._geometry = ScanGeometry([])

    def parse(self, line: str) -> Measurement | None:
        text = line.strip().removeprefix("\xef\xbb\xbf")
        if not text or text.startswith("#"):
            return None
        words = _split(_KEY.sub("", _SYNC.sub("", text)))
        if self._is_header:
            self._is_header = False
            if [_lower(word) for word in words] == self._names:
                return None
        if len(words) != len(self._names):
            raise ValueError(f"expected {len(self._names)} values ({' '.join(self._names)}), got {len(words)}")
        angle = self._direction * _number(words, self._angle[0], self._names[self._angle[0]])
        distance = _number(words, self._distance[0], self._names[self._distance[0]])
        if not math.isfinite(angle):
            raise ValueError(f"column {self._names[self._angle[0]]}: expected a finite angle, got {angle}")
        finished = self._finish() if self._starts_over(angle) else None
        if not self._beams:
            self._stamp_ns = self._stamp(words)
        if len(self._beams) >= _MOST_BEAMS:
            raise ValueError(f"expected at most {_MOST_BEAMS} beams before the angle starts over, got more")
        self._beams.append((angle, distance))
        return finished

    def end(self) -> Measurement | None:
        return self._finish() if self._beams else None

    def _starts_over(self, angle: float) -> bool:
        """Return whether a beam goes back against the direction of its scan."""
        if len(self._beams) < 2:
            return False
        swept = self._beams[-1][0] - self._beams[0][0]
        return math.copysign(1.0, swept) * (self._beams[-1][0] - angle) > _BACK * abs(swept)

    def _stamp(self, words: Sequence[str]) -> int:
        if self._time is None:
            return self._scans * _PERIOD_NS
        place, unit = self._time
        word = words[place]
        if not unit and word.isdecimal():
            unit = _SINCE_1970.get(len(word), "")
        try:
            return parse_stamp_ns(f"{word}e-{_OF_A_SECOND[unit]}" if unit not in ("", "s") else word)
        except ValueError as error:
            raise ValueError(f"column {self._names[place]}: {error}") from None

    def _finish(self) -> Measurement:
        """Make a scan of the beams so far."""
        angles, distances = np.array(self._beams).T
        self._beams = []
        self._scans += 1
        if self._units is None:
            self._units = self._find_units(angles, distances)
        bearings = angles / self._units[0]
        if problem := find_wrong_beam_angles(bearings[0], np.ptp(bearings) / max(len(bearings) - 1, 1), len(bearings)):
            raise ValueError(problem)
        if not np.array_equal(bearings, self._geometry.bearings):
            self._geometry = ScanGeometry(bearings)
        return Measurement(None, LaserScan.from_log(self._stamp_ns, distances / self._units[1], self._geometry))

    def _find_units(self, angles: FloatArray, distances: FloatArray) -> tuple[float, float]:
        usable = distances[np.isfinite(distances) & (distances > 0)]
        angle = self._angle[1] or ("deg" if np.abs(angles).max() > _MOST_RAD else "rad")
        distance = self._distance[1] or ("mm" if len(usable) and np.median(usable) > _MOST_M else "m")
        if not (self._angle[1] and self._distance[1]):
            self._statistics.remarks[
                f"the units are not stated: angles are taken as {angle}, distances as {distance}"
            ] += 1
        side, whose = ("clockwise", ", as an RPLIDAR's") if self._direction < 0 else ("counter-clockwise", "")
        self._statistics.remarks[f"the direction is not stated: angles are taken as {side}{whose}"] += 1
        if self._time is None:
            self._statistics.remarks["the scans have no stamps: they are taken as 0.1 s apart"] += 1
        return (math.degrees(1.0) if angle == "deg" else 1.0), _OF_A_METRE[distance]
