"""The bounded queue between callbacks and filter, in which scans wait for their transforms."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from enum import Enum
from typing import NamedTuple, TypeVar, final

import numpy as np

from gridslam.geometry.se2 import between
from gridslam.io.bags.ros_messages import ScanMessage, StampedTransform
from gridslam.pipeline import describe_error
from gridslam.ros.node.accepted_scan import AcceptedScan, MeasurementBuilder, find_refusal_reason
from gridslam.ros.node.live_transforms import JumpDetector, LiveTransforms, Warn
from gridslam.ros.node.parameters import NodeSettings
from gridslam.transforms import Coverage, MissingTransform
from gridslam.types import BeamStatus, FloatArray, Odometry, describe_duration

_CONTINUES_M = 0.5  # and rad: the odometry continues within this distance
_LATE_S = 0.5
_IGNORED_S = 10.0
_MIN_LATE_SCANS = 10  # in a row: a single scan may be delayed
_MAX_STEP = 1.0  # m and rad
_MAX_SPEED = 10.0  # m/s and rad/s: faster than any robot
_MAX_FRAMES = 256  # of lasers
_QUIET_S = 1.0  # a scan is lost without a warning this close to the first and the last transform
_MAY_ARRIVE = (Coverage.NOT_YET, Coverage.NOT_CONNECTED)

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")


class SessionEnd(Enum):
    """Why a session ends."""

    RESET = "reset"
    JUMP = "time jumped back, and the robot is elsewhere"
    CARRIED = "the robot was carried, and is looked for in the map so far"
    CLOSED = "closed"


class _Waiting(NamedTuple):
    message: ScanMessage
    sensor: str
    arrived_s: float
    after_jump: bool


@final
class Counts:
    """Counts of scans.

    Attributes
    ----------
    received, throttled, paused, refused, dropped, accepted, jumps, extrapolated : int
        All of them; those left out on request, and while the node paused; refused, with a warning unless it only lies
        before the first transform or after the last one; dropped because the filter was behind; given to the filter;
        times that the stamps jumped back; of those accepted, those whose odometry was late.
    """

    __slots__ = ("accepted", "dropped", "extrapolated", "jumps", "paused", "received", "refused", "throttled")

    def __init__(self) -> None:
        self.received = self.throttled = self.paused = self.refused = self.dropped = self.accepted = self.jumps = 0
        self.extrapolated = 0


@final
class MeasurementQueue:
    """Accepts messages from any thread and passes measurements to the filter's thread.

    Parameters
    ----------
    settings : NodeSettings
        Bounds and frames.
    warn : callable
        Called with refused data, by kind.
    clock : callable
        Monotonic time, s.

    Attributes
    ----------
    counts : Counts
        Counts of scans.
    is_paused : bool
        Whether incoming scans are dropped.
    received_s : float or None, s
        When the last scan came, by the clock; None before the first one.
    missing_transform : str
        The transform without which the last scan was refused; empty if that was not the reason, or it was accepted.
    """

    def __init__(self, settings: NodeSettings, warn: Warn, clock: Callable[[], float] = time.perf_counter) -> None:
        self.counts = Counts()
        self.is_paused = False
        self.received_s: float | None = None
        self.missing_transform = ""
        self._settings = settings
        self._warn = warn
        self._clock = clock
        self._changed = threading.Condition()
        self._caught_up_s = clock()  # when the filter last waited
        self._scans: deque[_Waiting] = deque()
        self._calls: deque[Callable[[], None]] = deque()
        self._session_end: SessionEnd | None = None
        self._transforms = LiveTransforms(settings.jump_s, warn)
        self._builders: dict[str, MeasurementBuilder] = {}
        self._mountings: dict[str, FloatArray] = {}
        self._latest_ns: dict[str, int] = {}
        self._jumps = JumpDetector(settings.jump_s)
        self._received_ns: dict[tuple[str, str], int] = {}
        self._late: dict[str, int] = {}
        self._odometry: Odometry | None = None
        self._pending_jump = False
        self._has_begun = False
        self._held = ""  # what is reported once the transforms go on: else this was their end

    def add_scan(self, message: ScanMessage, sensor: str) -> None:
        """Queue a scan, or refuse it; never blocks."""
        arrived_s = self._clock()
        settings = self._settings
        counts = self.counts
        with self._changed:
            counts.received += 1
            self.received_s = arrived_s
            if self.is_paused:
                counts.paused += 1
                return
            if (counts.received - 1) % settings.throttle_scans:
                counts.throttled += 1
                return
            if problem := find_refusal_reason(message, settings.min_beams, settings.max_beams):
                self._refuse("scan refused", f"{sensor}: {problem}")
                return
            source = sensor, message.frame
            if self._received_ns.get(source) == message.stamp_ns:
                self._refuse("scan refused", f"{sensor}: duplicate stamp; are there two publishers?")
                return
            _keep_newest(self._received_ns, source, message.stamp_ns)
            latest_ns = self._latest_ns.get(sensor, message.stamp_ns)
            jumped = self._jumps.detect(sensor, message.stamp_ns, latest_ns)
            if jumped is None:
                self._refuse("stamp jumped back", f"{sensor}: a scan is stamped long before the previous one")
                return
            if jumped:
                self._latest_ns[sensor] = message.stamp_ns
                counts.jumps += 1
                counts.dropped += len(self._scans)
                self._scans.clear()
            else:
                self._compare_clocks(message.stamp_ns, sensor)
            self._scans.append(_Waiting(message, sensor, arrived_s, jumped or self._pending_jump))
            self._pending_jump = False
            self._drop_old(arrived_s)
            self._changed.notify()

    def add_transforms(self, transforms: Sequence[StampedTransform], *, static: bool = False) -> None:
        """Add transforms; never blocks."""
        with self._changed:
            self._transforms.add(transforms, static=static)
            if self._scans:
                self._changed.notify()

    def post(self, call: Callable[[], None]) -> None:
        """Run a call in the filter's thread between two scans."""
        with self._changed:
            self._calls.append(call)
            self._changed.notify()

    def end_session(self, why: SessionEnd) -> None:
        """End the session and drop all queued scans; a closed queue returns no more measurements."""
        with self._changed:
            if self._session_end is not SessionEnd.CLOSED:
                self._session_end = why
            self._scans.clear()
            self._changed.notify()

    def take(self) -> AcceptedScan | Callable[[], None] | SessionEnd:
        """Wait for the next posted call, measurement, or end of the session."""
        with self._changed:
            while True:
                if self._calls:
                    return self._calls.popleft()
                if self._session_end is not None:
                    return self._take_session_end()
                accepted, wait_s = self._next_measurement()
                if accepted is not None:
                    return accepted
                self._changed.wait(wait_s)
                self._caught_up_s = self._clock()

    def _take_session_end(self) -> SessionEnd:
        why = self._session_end
        assert why is not None
        if why is not SessionEnd.CLOSED:
            self._session_end = None
        self._pending_jump = False
        self._forget_scans()
        return why

    def _next_measurement(self) -> tuple[AcceptedScan | SessionEnd | None, float | None]:
        """Return the first scan if its transforms are known, else the time to wait, s."""
        while self._scans:
            waiting = self._scans[0]
            waited_s = self._clock() - waiting.arrived_s
            try:
                accepted = self._make_measurement(waiting, waited_s)
            except MissingTransform as missing:
                due_s = self._time_to_wait(waiting, missing, waited_s)
                if due_s > 0:
                    return None, due_s
                self._discard()
                self._refuse_without_transform(missing)
                continue
            except Exception as error:
                self._discard()
                self._refuse("scan refused", f"{waiting.sensor}: {describe_error(error)}")
                continue
            if waiting.after_jump and not self._continues(accepted.measurement.odometry):
                self._scans[0] = waiting._replace(after_jump=False)
                self._forget_scans()
                return SessionEnd.JUMP, None
            self._scans.popleft()
            self.counts.accepted += 1
            self.missing_transform = ""
            self._check_measurement(accepted)
            return accepted, None
        return None, None

    def _time_to_wait(self, waiting: _Waiting, missing: MissingTransform, waited_s: float) -> float:
        """Return how long a scan still waits for a transform, s."""
        settings = self._settings
        if missing.coverage not in _MAY_ARRIVE and not waiting.after_jump:  # after a jump they may jump later
            return 0.0
        wait_s = settings.transform_wait_s
        if waited_s < settings.extrapolate_after_s < wait_s and settings.extrapolate_s:
            wait_s = settings.extrapolate_after_s
        return wait_s - waited_s

    def _refuse_without_transform(self, missing: MissingTransform) -> None:
        """Refuse a scan; without a warning if it only came before the first transform, or after the last one."""
        is_near = missing.apart_s <= _QUIET_S
        if is_near and missing.coverage is Coverage.TOO_EARLY and not self._has_begun:
            self.counts.refused += 1
        elif is_near and missing.coverage is Coverage.NOT_YET:
            self.counts.refused += 1
            self._held = str(missing)
        else:
            self._refuse("missing transform", str(missing))
        self.missing_transform = missing.link

    def _forget_scans(self) -> None:
        """Forget the scans that were taken, as those of a new session are compared with none of them."""
        self._odometry = None
        self._latest_ns.clear()
        self._has_begun = False
        self._held = ""

    def _make_measurement(self, waiting: _Waiting, waited_s: float) -> AcceptedScan:
        """Build the measurement of a scan; raises MissingTransform if a transform is not known (yet)."""
        message = waiting.message
        settings = self._settings
        odometry: Odometry | None = None
        if settings.odometry != "none":
            try:
                odometry = Odometry(message.stamp_ns, self._odometry_pose(waiting, waited_s))
            except MissingTransform as missing:
                last = waited_s >= settings.transform_wait_s
                if settings.odometry == "needed" or (missing.coverage in _MAY_ARRIVE and not last):
                    raise
                self._warn("scan without odometry", str(missing))
        try:
            mounting = self._transforms.buffer.lookup(settings.base_frame, message.frame, message.stamp_ns)
            _keep_newest(self._mountings, message.frame, mounting)
        except MissingTransform:
            if message.frame not in self._mountings:
                raise
            mounting = self._mountings[message.frame]
        builder = self._builders.setdefault(waiting.sensor, MeasurementBuilder())
        return builder.build(message, waiting.sensor, mounting, odometry, waiting.arrived_s)

    def _odometry_pose(self, waiting: _Waiting, waited_s: float) -> FloatArray:
        """Pose (3,) of the base in the odometry frame at a scan's stamp; extrapolated if the odometry is late."""
        settings = self._settings
        frames = settings.odom_frame, settings.base_frame
        stamp_ns = waiting.message.stamp_ns
        buffer = self._transforms.buffer
        pose: FloatArray | None = None
        try:
            pose = buffer.planar(*frames, stamp_ns)
        except MissingTransform as missing:
            is_late = missing.coverage is Coverage.NOT_YET and waited_s >= settings.extrapolate_after_s
            if is_late and settings.extrapolate_s and not waiting.after_jump:
                pose = buffer.extrapolate_planar(*frames, stamp_ns, settings.extrapolate_s)
            if pose is None:
                raise
            self.counts.extrapolated += 1
        pose.flags.writeable = False
        return pose

    def _check_measurement(self, accepted: AcceptedScan) -> None:
        self._has_begun = True
        if self._held:
            self._warn("missing transform", self._held)
            self._held = ""
        odometry, scan = accepted.measurement
        self._latest_ns[scan.sensor] = scan.stamp_ns
        if not (scan.status == BeamStatus.HIT).any():
            self._warn("no returns", f"{scan.sensor}: none of {len(scan.status)} beams hits anything in range")
        if odometry is None:
            return
        if self._odometry is not None:
            seconds = abs(odometry.stamp_ns - self._odometry.stamp_ns) * 1e-9
            dx, dy, turn = between(self._odometry.pose, odometry.pose).tolist()
            moved = math.hypot(dx, dy)
            if max(moved, abs(turn)) > _MAX_STEP + _MAX_SPEED * seconds:
                self._warn("odometry jumped", f"by {moved:.2f} m and {abs(turn):.2f} rad in {seconds:.3g} s")
        self._odometry = odometry

    def _continues(self, odometry: Odometry | None) -> bool:
        """Whether the odometry continues: then only a clock was set back."""
        if odometry is None or self._odometry is None:
            return False
        return bool(np.abs(between(self._odometry.pose, odometry.pose)).max() <= _CONTINUES_M)

    def _compare_clocks(self, stamp_ns: int, sensor: str) -> None:
        """Report scans that are always older than the odometry which came before: each would get an old pose."""
        newest_ns = self._transforms.newest_ns(self._settings.odom_frame)
        late_s = 0.0 if newest_ns is None else (newest_ns - stamp_ns) * 1e-9
        self._late[sensor] = self._late.get(sensor, 0) + 1 if _LATE_S < late_s < _IGNORED_S else 0
        if self._late[sensor] >= _MIN_LATE_SCANS:
            late = f"{sensor} is stamped {describe_duration(late_s)} before the latest odometry"
            self._warn("late scans", f"{late}: it is late, or the clocks differ")

    def _drop_old(self, now_s: float) -> None:
        """Drop the oldest scans beyond the limits of the queue: what came in a pause the filter can catch up with."""
        scans, settings = self._scans, self._settings
        queue_s = settings.queue_s if now_s - self._caught_up_s > settings.catch_up_s else math.inf
        while len(scans) > settings.queue_scans or now_s - scans[0].arrived_s > queue_s:
            self._discard()
            self.counts.dropped += 1

    def _discard(self) -> None:
        """Drop the first scan; a jump of time before it now belongs to the next scan."""
        if self._scans.popleft().after_jump:
            if self._scans:
                self._scans[0] = self._scans[0]._replace(after_jump=True)
            else:
                self._pending_jump = True

    def _refuse(self, kind: str, problem: str) -> None:
        self.counts.refused += 1
        self.missing_transform = ""
        self._warn(kind, problem)


def _keep_newest(values: dict[_Key, _Value], key: _Key, value: _Value) -> None:
    """Set a value, and forget the one that was set first when there are too many."""
    values.pop(key, None)
    values[key] = value
    if len(values) > _MAX_FRAMES:
        del values[next(iter(values))]
