"""Statistics of reading a log."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Any, final

from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray

_BY_SCAN = (
    "selection",
    "span_read",
    "scans",
    "beam_counts",
    "invalid_beams",
    "no_return_beams",
    "without_odometry",
    "odometry_length_m",
    "backward_stamps",
    "duplicate_stamps",
    "first_stamp_ns",
    "last_stamp_ns",
    "_last_sensor",
    "_last_place",
)
"""Counts of scans, as opposed to counts of the file as a whole."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Mounting:
    """Planar pose of a laser in the base frame (3,) = [x m, y m, theta rad], and where it is known from."""

    pose: FloatArray
    source: str


@final
@dataclass(frozen=True, slots=True)
class Topic:
    """Type of a topic's messages and how many a bag holds."""

    type: str
    messages: int


@final
@dataclass(slots=True)
class LogStatistics:
    """Counts that grow while a log is read; complete once the log is read to its end.

    The reader works in blocks, so while a log is being read the counts may be ahead of the scan last given by a block.

    Attributes
    ----------
    total_bytes, bytes_read : int
        Size of the file and how much of it has been read, both as on disk.
    lines : int
        Lines read.
    span_read : float
        Share in [0, 1] of the chosen time that has been read; 0 where all of the log is wanted.
    scans : Counter of str
        Scans by sensor; in CARMEN logs by tag of their line.
    beam_counts : Counter of int
        Scans by their number of beams.
    invalid_beams, no_return_beams : int
        Beams that measured nothing: NaN, negative and zero ranges; ranges at or above the maximum.
    odometry_lines : int
        Lines that carry odometry alone.
    without_odometry : int
        Scans for which the log has no odometry.
    odometry_length_m : float
        Length of the path of the odometry at the scans, m.
    backward_stamps, duplicate_stamps : int
        Scans stamped before the scan ahead of them, or like the scan ahead of them from the same sensor.
    first_stamp_ns, last_stamp_ns : int or None
        Stamps of the first and of the last scan in file order, ns.
    unused_tags : Counter of str
        Lines of other kinds, by tag.
    mountings : dict of str to Mounting
        By sensor.
    topics : dict of str to Topic
        All topics of a bag.
    missing_transforms : Counter of str
        Scans that had to be left out, or to go without odometry, by what is missing.
    missing_files : tuple of str
        Files of a bag that are not there.
    clock_offset_s : float, s
        How far the odometry's stamps are ahead of those of the scans that were recorded at the same time, where that is
        more than recorders and networks delay messages: they are of two clocks. Else 0.
    odometry_source : str
        Topic or frames of a bag that the odometry is taken from; empty where there is none.
    moving_mountings : Counter of str
        Scans, by sensor, whose laser was not mounted as at the first one: it tilts or turns on the robot.
    remarks : Counter of str
        What was decided, left out or doubtful, in sentences, and how often.
    faults : dict of str to str
        What the doctor found while the log was read, by code and laser, in sentences.
    selection : dict of str to int, float, bool or list of str
        Which part of the log was asked for, by the names of `LogOptions`; empty where all of it was.
    truncated : bool
        Whether the file is cut off and what is missing was left out on request.
    """

    total_bytes: int = 0
    bytes_read: int = 0
    span_read: float = 0.0
    lines: int = 0
    scans: Counter[str] = field(default_factory=Counter)
    beam_counts: Counter[int] = field(default_factory=Counter)
    invalid_beams: int = 0
    no_return_beams: int = 0
    odometry_lines: int = 0
    without_odometry: int = 0
    odometry_length_m: float = 0.0
    backward_stamps: int = 0
    duplicate_stamps: int = 0
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None
    unused_tags: Counter[str] = field(default_factory=Counter)
    mountings: dict[str, Mounting] = field(default_factory=dict)
    topics: dict[str, Topic] = field(default_factory=dict)
    missing_transforms: Counter[str] = field(default_factory=Counter)
    missing_files: tuple[str, ...] = ()
    clock_offset_s: float = 0.0
    odometry_source: str = ""
    moving_mountings: Counter[str] = field(default_factory=Counter)
    remarks: Counter[str] = field(default_factory=Counter)
    faults: dict[str, str] = field(default_factory=dict)
    selection: dict[str, Any] = field(default_factory=dict)
    truncated: bool = False
    _last_sensor: str = ""
    _last_place: list[float] | None = None

    def __repr__(self) -> str:
        """Return one line."""
        by_sensor = ", ".join(f"{count} of {sensor}" for sensor, count in list(self.scans.items())[:3])
        return f"LogStatistics({self.scan_count} scans, {self.duration_s:.1f} s{': ' * bool(by_sensor)}{by_sensor})"

    @property
    def scan_count(self) -> int:
        """Number of scans read."""
        return sum(self.scans.values())

    @property
    def duration_s(self) -> float:
        """Time from the first to the last scan, s; 0 where there is none."""
        if self.first_stamp_ns is None or self.last_stamp_ns is None:
            return 0.0
        return (self.last_stamp_ns - self.first_stamp_ns) / 1e9

    @property
    def share_read(self) -> float:
        """Ratio of the requested part of the log that has been read, in [0, 1]."""
        return max(self.bytes_read / max(self.total_bytes, 1), self.span_read)

    def of_scans(self, counts: LogStatistics) -> LogStatistics:
        """Return these statistics of the file, with those of the scans replaced by `counts`."""
        return replace(self, **{name: getattr(counts, name) for name in _BY_SCAN})

    def count(self, measurement: Measurement) -> None:
        """Take the next measurement into account."""
        odometry, scan = measurement
        self.scans[scan.sensor] += 1
        self.beam_counts[len(scan)] += 1
        status = scan.status.tobytes()  # counted several times as fast as the array
        self.invalid_beams += status.count(BeamStatus.INVALID)
        self.no_return_beams += status.count(BeamStatus.NO_RETURN)
        if self.last_stamp_ns is None:
            self.first_stamp_ns = scan.stamp_ns
        elif scan.stamp_ns < self.last_stamp_ns:
            self.backward_stamps += 1
        elif scan.stamp_ns == self.last_stamp_ns and scan.sensor == self._last_sensor:
            self.duplicate_stamps += 1
        self.last_stamp_ns = scan.stamp_ns
        self._last_sensor = scan.sensor
        if odometry is None:
            self.without_odometry += 1
            return
        place = odometry.pose.tolist()[:2]
        self.odometry_length_m += 0.0 if self._last_place is None else math.dist(self._last_place, place)
        self._last_place = place
