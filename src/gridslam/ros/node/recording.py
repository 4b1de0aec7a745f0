"""The record of what was accepted: a CSV of scans that `gridslam map` maps with identical results."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import IO, final

from gridslam.errors import OutputError
from gridslam.io.csv import COLUMNS
from gridslam.io.tables import format_stamp_ns
from gridslam.ros.node.accepted_scan import AcceptedScan, LaserDescription

__all__ = ["ScanRecorder"]


@final
class ScanRecorder:
    """Writes each accepted scan as one row in one write, so that a killed node loses none of them.

    If a row cannot be written because the disk is full, the record ends with the previous row.

    Parameters
    ----------
    path : str or Path
        The file, which is replaced if it exists.

    Raises
    ------
    OutputError
        The file cannot be written; also raised by `add`.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._cells_of_laser: dict[LaserDescription, tuple[str, str]] = {}
        try:
            self._file: IO[bytes] = self.path.open("wb", buffering=0)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
        self._write(",".join(COLUMNS))

    def add(self, accepted: AcceptedScan) -> None:
        """Write a row, exactly as passed to the filter; nothing after the record has ended."""
        if not self.is_whole:
            return
        (odometry, scan), laser = accepted.measurement, accepted.laser
        if laser not in self._cells_of_laser:
            self._cells_of_laser = {laser: _format_laser(laser)}  # only the last one: lasers rarely alternate
        names, description = self._cells_of_laser[laser]
        pose = "," * 3 if odometry is None else ",".join(map(repr, odometry.pose.tolist())) + ","
        ranges = " ".join(map(repr, scan.ranges.tolist()))
        self._write(f"{format_stamp_ns(scan.stamp_ns)},{names},{pose},{description},{ranges}")

    @property
    def is_whole(self) -> bool:
        """Whether the record contains all scans so far."""
        return not self._file.closed

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _write(self, line: str) -> None:
        rest, begin = memoryview(line.encode() + b"\n"), self._file.tell()
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            with suppress(OSError):
                self._file.truncate(begin)
            self._file.close()
            raise OutputError(f"{self.path}: {error.strerror or error}; the record ends before this scan") from None


def _format_laser(laser: LaserDescription) -> tuple[str, str]:
    """Return the cells of the names, and those from the mounting to the range limits."""
    time_increment = "" if laser.time_increment_s is None else repr(laser.time_increment_s)
    numbers = map(repr, (*laser.mounting, laser.angle_min, laser.angle_increment))
    limits = f"{laser.range_min_m!r},{laser.range_max_m!r}"
    return f"{_quote(laser.sensor)},{_quote(laser.frame)}", f"{','.join(numbers)},{time_increment},{limits}"


def _quote(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if "," in name or '"' in name else name
