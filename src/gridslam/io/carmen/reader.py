"""Streaming reader of CARMEN logs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import final

from gridslam.errors import InputError
from gridslam.io.carmen.lines import SCAN_TAGS
from gridslam.io.carmen.parser import CarmenParser
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.io.text import TextSource

__all__ = ["CarmenLog"]

_ODOM_WORDS = 10  # ODOM x y theta tv rv accel ipc_timestamp ipc_hostname logger_timestamp


@final
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
        parser = CarmenParser(self.path)
        statistics = self.statistics = parser.statistics
        statistics.total_bytes = source.total_bytes
        for lines in source:
            statistics.bytes_read = source.bytes_read
            if source.unterminated:
                yield from self._last_line(parser, lines[0], source.is_truncated)
            else:
                yield from parser.parse(lines)
        statistics.bytes_read = source.bytes_read
        if source.is_truncated:
            self._end_early("the compressed file is cut off")
        if statistics.scan_count == 0:
            others = ", ".join(sorted(statistics.unused_tags)[:5]) or "none"
            problem = f"expected laser scans ({', '.join(SCAN_TAGS)}), got no scan (other tags: {others})"
            raise InputError(self.path, problem)

    def _last_line(self, parser: CarmenParser, line: str, is_truncated: bool) -> Iterator[Measurement]:
        """Parse the last line, which no line end follows: it may be whole, or the file was cut off within it."""
        if is_truncated:
            return
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
