"""From lines of a CARMEN log to measurements."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.geometry.angles import wrap
from gridslam.io.carmen.lasers import CarmenLasers
from gridslam.io.carmen.lines import SCAN_TAGS, LineError, ScanRows, parse_pose, parse_rows, parse_stamp_ns
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry

__all__ = ["CarmenParser"]


@final
@dataclass(slots=True)
class _Batch:
    """Lines of scans that wait for their numbers to be converted together.

    `texts` and `places` are grouped by form, the pair of tag and number of blanks; a place is an index into the other
    lists.
    """

    texts: dict[tuple[str, int], list[str]] = field(default_factory=dict)
    places: dict[tuple[str, int], list[int]] = field(default_factory=dict)
    stamps_ns: list[int] = field(default_factory=list)
    lines: list[int] = field(default_factory=list)
    odometry_lines: list[tuple[str, int] | None] = field(default_factory=list)


@final
class CarmenParser:
    """One pass over a log: parameters, odometry and mountings of earlier lines hold for later ones."""

    def __init__(self, path: Path) -> None:
        """Start before the first line of the log at `path`."""
        self.statistics = LogStatistics()
        self._path = path
        self._lasers = CarmenLasers(path)
        self._has_poses: dict[str, bool] = {}
        self._odometry_line: tuple[str, int] | None = None
        self._batch = _Batch()

    def parse(self, lines: Sequence[str]) -> Iterator[Measurement]:
        """Yield the measurements in the next lines; raises InputError with the number of a malformed one."""
        statistics = self.statistics
        first = statistics.lines + 1
        for number, line in enumerate(lines, first):
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
        if tag.startswith("#"):
            self.statistics.comments += 1
        elif tag == "PARAM" and len(words) >= 3:
            name, value = words[1:3]
            self.statistics.parameters[name] = value
            if self._lasers.uses(name):
                yield from self._flush()
                self._lasers.set_parameter(name, value, number)
        elif tag in SCAN_TAGS:  # after or before other white space than one blank
            self._add(tag, line.strip(), number)
        else:
            self.statistics.unused_tags[tag] += 1

    def _add(self, tag: str, line: str, number: int) -> None:
        parts = line.rsplit(None, 3)
        if len(parts) < 4 or parts[0] == tag:
            raise InputError(self._path, f"expected a whole {tag} line, got {line[:60]!r}", number)
        text = parts[0][len(tag) + 1 :]
        try:
            stamp_ns = parse_stamp_ns(parts[1])
        except LineError as error:
            raise InputError(self._path, f"{error}, three words before the line's end", number) from None
        batch = self._batch
        form = (tag, text.count(" "))
        batch.texts.setdefault(form, []).append(text)
        batch.places.setdefault(form, []).append(len(batch.lines))
        batch.stamps_ns.append(stamp_ns)
        batch.lines.append(number)
        batch.odometry_lines.append(self._odometry_line)

    def _flush(self) -> Iterator[Measurement]:
        """Convert what waits and yield it in file order."""
        batch, self._batch = self._batch, _Batch()
        scans: list[tuple[int, Measurement]] = []
        for form, texts in batch.texts.items():
            tag, places = form[0], batch.places[form]
            try:
                for rows in parse_rows(tag, texts):
                    self._check_poses(tag, rows)
                    own = places[rows.first : rows.first + len(rows.ranges)]
                    scans.extend(zip(own, self._measurements(tag, rows, own, batch), strict=True))
            except LineError as error:
                raise InputError(self._path, str(error), batch.lines[places[error.row]]) from None
            self.statistics.scans[tag] += len(places)
        if len(batch.texts) > 1:
            scans.sort(key=lambda item: item[0])
        self._count(scans)
        for _, measurement in scans:
            yield measurement

    def _check_poses(self, tag: str, rows: ScanRows) -> None:
        """Refuse a line with another number of poses than those before: some of its readings are missing."""
        has = rows.robot_poses is not None
        if self._has_poses.setdefault(tag, has) != has:
            want, got = ("none", "six") if has else ("six", "none")
            raise LineError(f"expected {want} pose values after the readings as in lines before, got {got}", rows.first)

    def _measurements(self, tag: str, rows: ScanRows, places: list[int], batch: _Batch) -> Iterator[Measurement]:
        sensor = SCAN_TAGS[tag]
        geometry = self._lasers.geometry(tag, sensor, rows)
        self.statistics.mountings[sensor] = self._lasers.mountings[sensor]
        limit = self._lasers.range_max_m(sensor, rows.layout)
        ranges, status = rows.ranges, self._status(rows.ranges, limit)
        poses = None if rows.robot_poses is None else _normalised(rows.robot_poses)
        for array in (ranges, status, poses):
            if array is not None:
                array.flags.writeable = False
        frame = f"{sensor}_laser"
        for row, place in enumerate(places):
            stamp_ns = batch.stamps_ns[place]
            odometry = self._odometry(batch.odometry_lines[place]) if poses is None else Odometry(stamp_ns, poses[row])
            scan = LaserScan(stamp_ns, ranges[row], status[row], geometry, 0.0, limit, sensor, frame)
            yield Measurement(odometry, scan)

    def _status(self, ranges: FloatArray, limit: float) -> NDArray[np.uint8]:
        """Decide each beam's status (K, B) and count."""
        no_return, invalid = ranges >= limit, ~(ranges > 0)
        status = no_return * np.uint8(BeamStatus.NO_RETURN) + invalid * np.uint8(BeamStatus.INVALID)
        statistics = self.statistics
        statistics.beam_counts[ranges.shape[1]] += len(ranges)
        statistics.no_return_beams += int(np.count_nonzero(no_return))
        statistics.invalid_beams += int(np.count_nonzero(invalid))
        return status

    def _odometry(self, source: tuple[str, int] | None) -> Odometry | None:
        """Odometry of an ODOM line."""
        if source is None:
            return None
        line, number = source
        words = line.split()
        try:
            if len(words) < 8:
                raise LineError(f"expected ODOM x y theta tv rv accel and a stamp, got {len(words)} words")
            return Odometry(parse_stamp_ns(words[7]), _normalised(parse_pose(words[1:4])[None])[0])
        except LineError as error:
            raise InputError(self._path, str(error), number) from None

    def _count(self, scans: list[tuple[int, Measurement]]) -> None:
        poses = [measurement.odometry.pose for _, measurement in scans if measurement.odometry is not None]
        self.statistics.without_odometry += len(scans) - len(poses)
        if poses:
            self.statistics.count_path(np.array(poses))
        for _, measurement in scans:
            self.statistics.count_stamp(measurement.scan)


def _normalised(poses: FloatArray) -> FloatArray:
    """Copy of poses (N, 3) with theta in [-pi, pi)."""
    return np.column_stack([poses[:, :2], wrap(poses[:, 2])])
