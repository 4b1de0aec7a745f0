"""One pass over a bag: scans wait until the odometry at their stamp is known."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple, final

from gridslam.errors import ArgumentError
from gridslam.io.bags.choice import Choice
from gridslam.io.bags.rig import Rig
from gridslam.io.bags.ros_messages import (
    MessageError,
    ScanMessage,
    decode_odometry,
    decode_scan,
    decode_transforms,
    kind_of,
    wire_of_cdr,
    wire_of_ros1,
)
from gridslam.io.bags.scans import BagScanBuilder
from gridslam.io.bags.source import BagSource
from gridslam.io.bags.survey import Survey, make_input_error
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.transforms import Coverage
from gridslam.types import Odometry

__all__ = ["BagReading"]

_PATIENCE_NS = 1_000_000_000
_MOST_WAITING = 1000  # scans, whatever the times of recording
_WHY = {
    Coverage.NOT_YET: "odometry: no reading at or after the scan's stamp comes within 1 s of the log",
    Coverage.TOO_EARLY: "odometry: no reading at or before the scan's stamp",
    Coverage.NOT_CONNECTED: "odometry: no reading comes before the scan or within 1 s of the log after it",
}


class _Waiting(NamedTuple):
    """A scan that waits for odometry or for other lasers, and until when in the time of recording."""

    until_ns: int
    stamp_ns: int
    topic: str
    message: ScanMessage


@final
class BagReading:
    """One pass over a bag, see `BagLog`; counts in `statistics`."""

    def __init__(self, source: BagSource, seen: Survey, choice: Choice, statistics: LogStatistics) -> None:
        self._source, self._seen, self._choice, self._statistics = source, seen, choice, statistics
        self._rig = Rig(choice, seen)
        self._maker = BagScanBuilder()
        self._waiting: deque[_Waiting] = deque()
        self._latest_ns = dict.fromkeys(choice.scans, -1)

    def measurements(self) -> Iterator[Measurement]:
        """Yield the measurements of the whole bag."""
        source, choice, waiting = self._source, self._choice, self._waiting
        kinds = {name: kind_of(topic.type) for name, topic in source.topics.items()}
        wanted = {*choice.scans, choice.odometry, *self._rig.topics}
        time_ns = 0
        for time_ns, name, data in source.messages(wanted):
            try:
                news = self._take(name, kinds[name], data, time_ns)
                while news and waiting and (measurement := self._next(time_ns)) is not None:
                    yield measurement
            except MessageError as error:
                raise make_input_error(source, name, time_ns, error) from None
        while waiting:
            measurement = self._measurement(waiting.popleft(), last=True)
            if measurement is not None:
                yield measurement

    def _take(self, name: str, kind: str, data: bytes, time_ns: int) -> bool:
        """Process a message; return whether a scan may be ready now."""
        wire = wire_of_ros1(data) if self._source.is_ros1 else wire_of_cdr(data)
        if kind == "scan":
            self._await(name, decode_scan(data, wire), time_ns)
            return True
        try:
            if kind == "odometry":
                message = decode_odometry(data, wire)
                if not self._seen.odometry[name].stamped:
                    message = message._replace(stamp_ns=time_ns)
                self._rig.add_odometry(message)
                return True
            news = False
            for transform in decode_transforms(data, wire):
                news |= self._rig.add_transform(transform)
            return news
        except ArgumentError:
            self._statistics.remarks[f"a reading of {name} is no pose: left out"] += 1
            return False

    def _await(self, name: str, message: ScanMessage, time_ns: int) -> None:
        """Put a scan in the queue: behind those of its own laser, and by its stamp among those of others."""
        stamp_ns = message.stamp_ns if self._seen.scans[name].stamped else time_ns
        self._latest_ns[name] = max(stamp_ns, self._latest_ns[name])
        waiting, place = self._waiting, len(self._waiting)
        while place and waiting[place - 1].stamp_ns > stamp_ns and waiting[place - 1].topic != name:
            place -= 1
        waiting.insert(place, _Waiting(time_ns + _PATIENCE_NS, stamp_ns, name, message))

    def _next(self, time_ns: int) -> Measurement | None:
        """The measurement of the scan that is the next one, if it need not wait."""
        scan = self._waiting[0]
        last = time_ns > scan.until_ns or len(self._waiting) > _MOST_WAITING
        if not last and (min(self._latest_ns.values()) < scan.stamp_ns or self._rig.latest_ns < scan.stamp_ns):
            return None
        measurement = self._measurement(scan, last)
        if measurement is not None:
            self._waiting.popleft()
        return measurement

    def _measurement(self, scan: _Waiting, last: bool) -> Measurement | None:
        """Measurement of a scan; None where its odometry may still come, unless this is the `last` chance."""
        odometry: Odometry | None = None
        statistics = self._statistics
        if self._rig.has_odometry:
            coverage, odometry = self._rig.odometry(scan.stamp_ns)
            if odometry is None:
                if not last and coverage is not Coverage.TOO_EARLY:
                    return None
                statistics.missing_transforms[_WHY[coverage]] += 1
        message, topic = scan.message, scan.topic
        laser = self._rig.laser(message.frame)
        if topic not in statistics.mountings:
            statistics.mountings[topic] = laser.mounting
        if not laser.is_known:
            statistics.missing_transforms[f"mounting: {laser.mounting.source}"] += 1
        if laser.has_moved:
            statistics.moving_mountings[topic] += 1
        made = self._maker.scan(message, scan.stamp_ns, topic, laser.base_from_laser)
        if message.time_increment > 0 and made.beam_times_s is None:
            statistics.remarks[f"by the time_increment of {topic} a scan takes 10 s or more: not used"] += 1
        measurement = Measurement(odometry, made)
        statistics.count(measurement)
        statistics.bytes_read = self._source.bytes_read
        return measurement
