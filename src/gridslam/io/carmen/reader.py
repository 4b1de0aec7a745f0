"""Streaming reader of CARMEN logs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.angles import wrap_headings
from gridslam.io.carmen.lasers import USED_PARAMETERS, CarmenLasers
from gridslam.io.carmen.lines import SCAN_TAGS, LineError, ScanRows, parse_pose, parse_rows
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.io.tables import parse_stamp_ns
from gridslam.io.text import TextSource
from gridslam.types import BeamStatus, LaserScan, Odometry

_ODOM_WORDS = 10  # ODOM x y theta tv rv accel ipc_timestamp ipc_hostname logger_timestamp


@final
@checked
class CarmenLog:
    """A CARMEN log (plain, gzip or bzip2, detected from its content); iterating yields a `Measurement` for each scan.

    Scans come in file order, which is the order of the measurements although stamps jitter: backward stamps are
    counted, never sorted. A scan's odometry is the robot's pose in its own line, at the scan's stamp; for lines without
    one it is the last ODOM line before. Each iteration rereads the file, in blocks, and restarts `statistics`.

    Parameters
    ----------
    path : str or Path
        The log.
    keep_truncated : bool
        Whether a file that is cut off gives the scans that are there instead of raising at its end.

    Attributes
    ----------
    statistics : LogStatistics
        What the latest iteration has met so far.

    Raises
    ------
    InputError
        At construction where there is no such file or it is empty; while iterating where a line is malformed (with its
        number), where the file is binary, damaged or cut off, or where it ends without any scan.

    Notes
    -----
    Ranges at or above the sensor's maximum are NO_RETURN (see `CarmenLasers.range_max_m`); NaN, negative and zero ones
    are INVALID and counted. ODOM lines are checked only where a scan needs them. A scan's arrays are read-only views of
    its block's (about 100 scans), so copy those of a few scans that are to be kept for long.
    """

    def __init__(self, path: str | Path, *, keep_truncated: bool = False) -> None:
        """Check that there is a file; it is read by iterating."""
        self.path = Path(path)
        self.keep_truncated = keep_truncated
        self.statistics = LogStatistics(total_bytes=TextSource(path).total_bytes)

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        source = TextSource(self.path)
        parser = _Parser(self.path)
        statistics = self.statistics = parser.statistics
        statistics.total_bytes = source.total_bytes
        for lines in source:
            statistics.bytes_read = source.bytes_read
            if not source.unterminated:
                yield from parser.parse(lines)
            elif not source.is_truncated:
                yield from self._last_line(parser, lines[0])
        statistics.bytes_read = source.bytes_read
        if source.is_truncated:
            self._end_early("the compressed file is cut off")
        if statistics.scan_count == 0:
            others = ", ".join(sorted(statistics.unused_tags)[:5]) or "none"
            problem = f"expected laser scans ({', '.join(SCAN_TAGS)}), got no scan (other tags: {others})"
            raise InputError(self.path, problem)

    def _last_line(self, parser: _Parser, line: str) -> Iterator[Measurement]:
        """Parse the last line, which no line end follows: it may be whole, or the file was cut off within it."""
        tag = line.partition(" ")[0]
        cut_tag = any(known.startswith(tag) and known != tag for known in (*SCAN_TAGS, "ODOM", "PARAM"))
        if cut_tag or (tag == "ODOM" and len(line.split()) < _ODOM_WORDS):
            self._end_early(f"the last line is cut off, got {line!r}")
            return
        try:
            yield from parser.parse([line])
        except InputError as error:
            self._end_early(f"the last line is cut off or malformed ({error})")

    def _end_early(self, problem: str) -> None:
        self.statistics.truncated = True
        if not self.keep_truncated:
            raise InputError(self.path, f"{problem}; {self.statistics.scan_count} scans were read before")


class _ScanLine(NamedTuple):
    """A line that waits for its numbers to be converted together with others of its form."""

    number: int
    text: str
    stamp_ns: int
    odometry_line: tuple[str, int] | None


@final
class _Parser:
    """One pass over a log: parameters, odometry and mountings of earlier lines hold for later ones."""

    def __init__(self, path: Path) -> None:
        self.statistics = LogStatistics()
        self._path = path
        self._lasers = CarmenLasers(path)
        self._has_poses: dict[str, bool] = {}
        self._odometry_line: tuple[str, int] | None = None
        self._waiting = defaultdict[tuple[str, str | int], list[_ScanLine]](list)  # by tag and form

    def parse(self, lines: Sequence[str]) -> Iterator[Measurement]:
        """Yield the measurements in the next lines; raises InputError with the number of a malformed one."""
        statistics = self.statistics
        for number, line in enumerate(lines, statistics.lines + 1):
            tag = line.partition(" ")[0]
            if tag == "ODOM":
                statistics.odometry_lines += 1
                self._odometry_line = (line, number)
            elif tag in SCAN_TAGS:
                self._add(tag, line, number)
            elif line and not line.isspace():
                yield from self._other(line, number)
        statistics.lines += len(lines)
        yield from self._flush()

    def _other(self, line: str, number: int) -> Iterator[Measurement]:
        words = line.split()
        tag = words[0]
        if tag == "PARAM" and len(words) >= 3:
            name, value = words[1:3]
            if name in USED_PARAMETERS:
                yield from self._flush()
                self._lasers.set_parameter(name, value, number)
        elif tag in SCAN_TAGS:  # after or before other white space than one blank
            self._add(tag, line.strip(), number)
        elif not tag.startswith("#"):
            self.statistics.unused_tags[tag] += 1

    def _add(self, tag: str, line: str, number: int) -> None:
        parts = line.rsplit(None, 3)
        if len(parts) < 4 or parts[0] == tag:
            raise InputError(self._path, f"expected a whole {tag} line, got {line[:60]!r}", number)
        text = parts[0][len(tag) + 1 :]
        try:
            stamp_ns = parse_stamp_ns(parts[1])
        except ValueError as error:
            raise InputError(self._path, f"{error}, three words before the line's end", number) from None
        form = text.count(" ") if tag == "ROBOTLASER1" else text.partition(" ")[0]  # the others begin with a count
        self._waiting[tag, form].append(_ScanLine(number, text, stamp_ns, self._odometry_line))

    def _flush(self) -> Iterator[Measurement]:
        """Convert the pending lines and yield them in file order."""
        scans: list[tuple[int, Measurement]] = []
        for (tag, _), lines in self._waiting.items():
            try:
                for first, rows in parse_rows(tag, [line.text for line in lines]):
                    self._check_poses(tag, rows, lines[first].number)
                    scans.extend(self._measurements(tag, rows, lines[first : first + len(rows.ranges)]))
            except (LineError, ArgumentError) as error:  # ArgumentError: no scan has such beams
                row = error.row if isinstance(error, LineError) else 0
                raise InputError(self._path, str(error), lines[row].number) from None
        self._waiting.clear()
        scans.sort(key=itemgetter(0))
        for _, measurement in scans:
            self.statistics.count(measurement)
            yield measurement

    def _check_poses(self, tag: str, rows: ScanRows, number: int) -> None:
        """Refuse a line with another number of poses than those before: some of its readings are missing."""
        has = rows.robot_poses is not None
        if self._has_poses.setdefault(tag, has) != has:
            want, got = ("none", "six") if has else ("six", "none")
            problem = f"expected {want} pose values after the readings as in lines before, got {got}"
            raise InputError(self._path, problem, number)

    def _measurements(self, tag: str, rows: ScanRows, lines: list[_ScanLine]) -> Iterator[tuple[int, Measurement]]:
        """Yield the scans of one form, each with the number of its line."""
        sensor = SCAN_TAGS[tag]
        geometry = self._lasers.geometry(tag, sensor, rows)
        self.statistics.mountings[sensor] = self._lasers.mountings[sensor]
        limit = self._lasers.range_max_m(sensor, rows.layout)
        ranges = rows.ranges
        status = (ranges >= limit) * np.uint8(BeamStatus.NO_RETURN) + ~(ranges > 0) * np.uint8(BeamStatus.INVALID)
        poses = None if rows.robot_poses is None else wrap_headings(rows.robot_poses)
        for array in (ranges, status, poses):
            if array is not None:
                array.flags.writeable = False
        frame = f"{sensor}_laser"
        for row, line in enumerate(lines):
            scan = LaserScan(line.stamp_ns, ranges[row], status[row], geometry, 0.0, limit, sensor, frame)
            odometry = self._odometry(line.odometry_line) if poses is None else Odometry(line.stamp_ns, poses[row])
            yield line.number, Measurement(odometry, scan)

    def _odometry(self, source: tuple[str, int] | None) -> Odometry | None:
        """Return odometry of an ODOM line."""
        if source is None:
            return None
        line, number = source
        words = line.split()
        try:
            if len(words) < 8:
                raise LineError(f"expected ODOM x y theta tv rv accel and a stamp, got {len(words)} words")
            return Odometry(parse_stamp_ns(words[7]), wrap_headings(parse_pose(words[1:4])[None])[0])
        except ValueError as error:
            raise InputError(self._path, str(error), number) from None
