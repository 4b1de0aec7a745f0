"""The record of what was accepted: a CSV of scans that `gridslam map` maps with identical results."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import IO, final

from gridslam.errors import OutputError
from gridslam.io.carmen_lines import format_stamp_ns
from gridslam.io.csv_columns import COLUMNS
from gridslam.ros.accepted import Accepted, LaserForm

__all__ = ["ScanRecorder"]


@final
class ScanRecorder:
    """Writes each accepted scan as one whole row, so that a node which is killed has lost none of them.

    Where a row cannot be written, as the disk is full, the record ends with the row before.

    Parameters
    ----------
    path : str or Path
        A new file, or one that is replaced.

    Raises
    ------
    OutputError
        The file cannot be written; from `add`, too.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._forms: dict[LaserForm, tuple[str, str]] = {}
        try:
            self._file: IO[bytes] = self.path.open("wb", buffering=0)
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
        self._write(",".join(COLUMNS))

    def add(self, accepted: Accepted) -> None:
        """Write a row, exactly what the filter is given; nothing where the record has ended."""
        if not self.is_whole:
            return
        (odometry, scan), form = accepted.measurement, accepted.form
        if form not in self._forms:
            self._forms = {form: _cells_of(form)}  # the last one: the others come back seldom
        names, laser = self._forms[form]
        pose = "," * 3 if odometry is None else ",".join(map(repr, odometry.pose.tolist())) + ","
        ranges = " ".join(map(repr, scan.ranges.tolist()))
        self._write(f"{format_stamp_ns(scan.stamp_ns)},{names},{pose},{laser},{ranges}")

    @property
    def is_whole(self) -> bool:
        """Whether all scans that came are in it, and those that come will be."""
        return not self._file.closed

    def close(self) -> None:
        """End the file."""
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


def _cells_of(form: LaserForm) -> tuple[str, str]:
    """Cells of the names, and those from the mounting to the range limits."""
    on_progress = "" if form.time_increment_s is None else repr(form.time_increment_s)
    numbers = map(repr, (*form.mounting, form.angle_min, form.angle_increment))
    limits = f"{form.range_min_m!r},{form.range_max_m!r}"
    return f"{_quoted(form.sensor)},{_quoted(form.frame)}", f"{','.join(numbers)},{on_progress},{limits}"


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if "," in name or '"' in name else name
