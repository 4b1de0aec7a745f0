"""Streaming reader of ROS 1 and ROS 2 bags."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from gridslam.errors import ArgumentError, InputError
from gridslam.io.bags.rig import Rig
from gridslam.io.bags.ros_messages import ScanMessage, kind_of
from gridslam.io.bags.source import BagSource
from gridslam.io.bags.survey import Choice, Decoded, Survey, choose, decoded_messages, find_scan_problem, survey
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.io.selection import LogOptions
from gridslam.transforms import Coverage
from gridslam.types import FloatArray, LaserScan, Odometry, ScanGeometry

_ALL = LogOptions()
_PATIENCE_NS = 1_000_000_000
_MOST_WAITING = 1000  # scans, whatever the times of recording
_WHY = {
    Coverage.NOT_YET: "odometry: no reading at or after the scan's stamp comes within 1 s of the log",
    Coverage.TOO_EARLY: "odometry: no reading at or before the scan's stamp",
    Coverage.NOT_CONNECTED: "odometry: no reading comes before the scan or within 1 s of the log after it",
}


@final
class BagLog:
    """A bag (ROS 1, or ROS 2 as a folder, .db3 or .mcap); iterating yields a `Measurement` for each scan.

    Scans of one laser come in the order of their recording; those of several are merged by their stamps. Stamps are
    those of the messages' headers (of a topic that leaves them 0, the times of recording). A scan's odometry is
    interpolated at its own stamp: scans wait for the reading after it, up to 1 s of the log. Where none comes, or none
    was before, the measurement is without odometry, which `statistics.missing_transforms` counts with the reason.
    Each iteration rereads the bag and restarts `statistics`; memory does not grow with the length of the log.

    The choice of topics and frames, and when the user must choose, is described at `gridslam.io.bags.survey.choose`.

    Parameters
    ----------
    path : str or Path
        File or folder.
    options : LogOptions
        Topics, frames, `no_odometry` and `keep_truncated`; the choice of scans by time is not made here.

    Attributes
    ----------
    choice : Choice
        What is read.
    statistics : LogStatistics
        What the latest iteration has met so far; topics and remarks from the beginning.

    Raises
    ------
    InputError
        At construction where there is no such bag, it is damaged or cut off, it has no scans, or it is not clear what
        to read of it; while iterating where it turns out to be damaged, or a message cannot be decoded.
    """

    def __init__(self, path: str | Path, options: LogOptions = _ALL) -> None:
        """Look into the bag."""
        self.path = Path(path)
        self._source = BagSource(self.path, keep_truncated=options.keep_truncated)
        self._seen = survey(self._source)
        self.choice = choose(self._source, self._seen, options)
        self.statistics = self._new_statistics()

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        statistics = self.statistics = self._new_statistics()
        reading = _BagReading(self._source, self._seen, self.choice, statistics)
        yield from reading.measurements()
        statistics.bytes_read = self._source.bytes_read
        statistics.truncated = self._source.is_truncated
        if not statistics.scan_count:
            raise InputError(self.path, f"there are no scans on {', '.join(self.choice.scans)}")

    def _new_statistics(self) -> LogStatistics:
        source = self._source
        choice = self.choice
        statistics = LogStatistics(
            total_bytes=source.total_bytes,
            topics=dict(source.topics),
            missing_files=source.missing_files,
            remarks=Counter(choice.remarks),
            truncated=source.is_truncated,
        )
        if choice.odometry_frame:
            statistics.odometry_source = choice.odometry or f"{choice.odometry_frame} to {choice.base_frame} on /tf"
        for what, count in self._seen.unusable.items():
            statistics.remarks[f"{what} is no pose (not finite, or no rotation): left out"] += count
        for name in choice.scans:
            if not self._seen.scans[name].stamped:
                statistics.remarks[f"the scans of {name} are not stamped: the times of recording are taken"] += 1
        return statistics


class _Waiting(NamedTuple):
    """A scan that waits for odometry or for other lasers, and until when in the time of recording."""

    until_ns: int
    stamp_ns: int
    topic: str
    message: ScanMessage


@final
class _BagReading:
    """One pass over a bag, see `BagLog`; counts in `statistics`."""

    def __init__(self, source: BagSource, seen: Survey, choice: Choice, statistics: LogStatistics) -> None:
        self._source = source
        self._seen = seen
        self._statistics = statistics
        self._rig = Rig(choice, seen)
        self._clocks = ClockComparison()
        self._waiting: deque[_Waiting] = deque()
        self._beams: dict[str, int] = {}  # of the first scan of each topic
        self._problems: dict[str, str] = {}  # the first one of each topic
        self._latest_ns = dict.fromkeys(choice.scans, -1)
        wanted = {*choice.scans, choice.odometry, *self._rig.topics}
        self._kinds = {name: kind_of(topic.type) for name, topic in source.topics.items() if name in wanted}

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements of the whole bag."""
        for time_ns, name, message in decoded_messages(self._source, self._kinds):
            if self._take(name, message, time_ns):
                yield from self._ready(time_ns)
        yield from self._ready(math.inf)

    def _take(self, name: str, message: Decoded, time_ns: int) -> bool:
        """Process a message; return whether a scan may be ready now."""
        if isinstance(message, ScanMessage):
            self._await(name, message, time_ns)
            return True
        try:
            news = False
            if isinstance(message, list):
                for transform in message:
                    news |= self._rig.add_transform(transform)
            else:
                stamped = self._seen.odometry[name].stamped
                self._rig.add_odometry(message if stamped else message._replace(stamp_ns=time_ns))
                news = True
            if news:
                self._clocks.add_odometry(self._rig.latest_ns, time_ns)
            return news
        except ArgumentError:
            self._statistics.remarks[f"a reading of {name} is no pose: left out"] += 1
            return False

    def _await(self, name: str, message: ScanMessage, time_ns: int) -> None:
        """Put a scan in the queue: behind those of its own laser, and by its stamp among those of others."""
        beams = len(message.ranges)  # a scan that was cut short is none of wrong angles
        is_whole = beams in (0, self._beams.setdefault(name, beams))
        if is_whole and (problem := find_scan_problem(message)):
            first = self._problems.setdefault(name, problem)
            self._statistics.remarks[f"scans of {name} left out, of which no map can be made: {first}"] += 1
            return
        stamp_ns = message.stamp_ns if self._seen.scans[name].stamped else time_ns
        self._latest_ns[name] = max(stamp_ns, self._latest_ns[name])
        self._clocks.add_scan(stamp_ns, time_ns)
        waiting = self._waiting
        place = len(waiting)
        while place and waiting[place - 1].stamp_ns > stamp_ns and waiting[place - 1].topic != name:
            place -= 1
        waiting.insert(place, _Waiting(time_ns + _PATIENCE_NS, stamp_ns, name, message))

    def _ready(self, time_ns: float) -> Iterator[Measurement]:
        """Yield the measurements of the next scans that need not wait at this time of recording."""
        while self._waiting and (measurement := self._measurement(self._waiting[0], time_ns)) is not None:
            self._waiting.popleft()
            yield measurement

    def _measurement(self, scan: _Waiting, time_ns: float) -> Measurement | None:
        """Return measurement of a scan; None where its odometry or an earlier scan may still come."""
        last = time_ns > scan.until_ns or len(self._waiting) > _MOST_WAITING
        if not last and (min(self._latest_ns.values()) < scan.stamp_ns or self._rig.latest_ns < scan.stamp_ns):
            return None
        odometry: Odometry | None = None
        statistics = self._statistics
        if self._rig.has_odometry:
            coverage, odometry = self._rig.odometry(scan.stamp_ns)
            if odometry is None:
                if not last and coverage is not Coverage.TOO_EARLY:
                    return None
                statistics.missing_transforms[_WHY[coverage]] += 1
        message = scan.message
        topic = scan.topic
        laser = self._rig.laser(message.frame)
        if topic not in statistics.mountings:
            statistics.mountings[topic] = laser.mounting
        if not laser.is_known:
            statistics.missing_transforms[f"mounting: {laser.mounting.source}"] += 1
        if laser.has_moved:
            statistics.moving_mountings[topic] += 1
        made = _make_scan(message, scan.stamp_ns, topic, laser.base_from_laser)
        if message.time_increment > 0 and made.beam_times_s is None:
            statistics.remarks[f"by the time_increment of {topic} a scan takes 10 s or more: not used"] += 1
        measurement = Measurement(odometry, made)
        statistics.count(measurement)
        statistics.clock_offset_s = self._clocks.offset_s
        statistics.bytes_read = self._source.bytes_read
        return measurement


@final
class ClockComparison:
    """Compares the clocks that stamp scans and odometry, by the times at which both were recorded."""

    def __init__(self) -> None:
        """Nothing was recorded."""
        self._latest: tuple[int, int] | None = None  # of the odometry: stamp and time of recording, ns
        self._least_ns: int | None = None
        self._spans: dict[str, tuple[int, int]] = {}

    def add_odometry(self, stamp_ns: int, time_ns: int) -> None:
        """Take the stamp of a reading, and when it was recorded."""
        self._latest = stamp_ns, time_ns
        self._extend("odometry", stamp_ns)

    def add_scan(self, stamp_ns: int, time_ns: int) -> None:
        """Take the stamp of a scan, and when it was recorded."""
        self._extend("scans", stamp_ns)
        if self._latest is not None:
            apart_ns = self._latest[0] - stamp_ns - (self._latest[1] - time_ns)
            if self._least_ns is None or abs(apart_ns) < abs(self._least_ns):
                self._least_ns = apart_ns

    def _extend(self, what: str, stamp_ns: int) -> None:
        first, last = self._spans.get(what, (stamp_ns, stamp_ns))
        self._spans[what] = min(first, stamp_ns), max(last, stamp_ns)

    @property
    def offset_s(self) -> float:
        """How far the odometry's stamps are ahead, s; 0 where the messages' delays may be all there is."""
        if len(self._spans) < 2:
            return 0.0
        (first, last), (begin, end) = self._spans["scans"], self._spans["odometry"]
        apart_ns = self._least_ns or 0
        if abs(apart_ns) <= _PATIENCE_NS and (end < first or begin > last):  # written in the order of their stamps
            apart_ns = begin - first
        return apart_ns / 1e9 if abs(apart_ns) > _PATIENCE_NS else 0.0


@lru_cache(maxsize=64)  # cheap lidars turn unevenly, so that each scan has angles of its own
def _make_geometry(angle_min: float, angle_increment: float, beams: int, base_from_laser: bytes) -> ScanGeometry:
    """Return the geometry of scans with the same angles and mounting, which they share."""
    mounting = np.frombuffer(base_from_laser).reshape(4, 4)
    return ScanGeometry(angle_min + angle_increment * np.arange(beams), mounting)


def _make_scan(message: ScanMessage, stamp_ns: int, sensor: str, base_from_laser: FloatArray) -> LaserScan:
    """Make a scan, by the rules of `LaserScan.from_ros`."""
    angles = message.angle_min, message.angle_increment
    return LaserScan.from_ros(
        stamp_ns,
        message.ranges,
        angle_min=message.angle_min,
        angle_increment=message.angle_increment,
        range_min=message.range_min,
        range_max=message.range_max,
        time_increment=message.time_increment,
        geometry=_make_geometry(*angles, len(message.ranges), base_from_laser.tobytes()),
        sensor=sensor,
        frame=message.frame,
    )
