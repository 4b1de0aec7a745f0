"""Detect where a robot was carried: the view changes from one scan to the next while the odometry is continuous."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from operator import itemgetter
from typing import Generic, TypeVar, final

import numpy as np

from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.range_units import polar_scan
from gridslam.doctor.scan_prediction import PolarScan, disagreements, log_ratios_as_reported, move_laser
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, LaserScan

__all__ = ["DriveNumbering", "ViewBreaks", "split_where_carried"]

_Item = TypeVar("_Item")

_SMALL_M = 0.3  # odometry between two scans: after more the view is another one anyway
_SMALL_RAD = 0.3
_AT_ONCE_S = 0.35  # and half of that motion: nobody passes a door that fast, so that all may be farther, or nearer
_SAMPLES = 60  # ranges of a scan that are looked at first
_CHANGED_M = 0.1  # change of a range above noise, and
_CHANGED = 0.02  # of the range
_COVER_M = 0.3  # hands and arms are nearer while the robot is carried
_BLIND = 0.25  # of the beams that saw something before
_MOST_CHANGED = 0.5  # of these ranges: where fewer change no scan is predicted
_OTHER = 0.2  # median logarithm of the ratio of predicted and measured range; on real logs a hundredth to a tenth
_STILL_OTHER = 0.15  # and at once; on real logs and among people no alarm was false at 0.12 either
_SAME = 0.1
_MANY = 0.2  # of the beams
_SIDE = 0.05  # of the logarithms: that much nearer, or farther
_WATCHED = 10  # scans after a break: who passes closely is gone by then, or the view from before is back
_FEWEST = 8  # of them that have enough in common with the view from before to differ from it
_MOSTLY = 0.75  # of the scans after it that agree with the one before: a laser that fails sees another room in each
_SHOWN = 5
_MOST_HELD = 100  # scans: a laser that falls silent decides nothing


@final
class _View:
    """A scan with the pose (3,) of the odometry; its ranges are ordered by bearing once they are needed.

    `sampled` are some of the ranges, 0 where nothing was hit; `seen` counts those that are of no cover.
    """

    def __init__(self, pose: FloatArray, scan: LaserScan) -> None:
        self.pose = pose
        self.scan = scan
        self.sampled = self.sample(0, len(scan))
        self.seen = int(np.count_nonzero(self.sampled > _COVER_M))

    def sample(self, first: int, end: int) -> FloatArray:
        """Some of the ranges of the beams from `first` on, 0 where nothing was hit."""
        some = slice(first, end, max(len(self.scan) // _SAMPLES, 1))
        return np.where(self.scan.status[some] == BeamStatus.HIT, self.scan.ranges[some], 0.0)

    @cached_property
    def polar(self) -> PolarScan | None:
        return polar_scan(self.scan)

    def is_blind_beside(self, before: _View) -> bool:
        """Whether hardly anything is seen, beside before: the laser is covered, or held to floor or ceiling."""
        return self.seen < _BLIND * before.seen

    def is_changed_from(self, before: _View) -> bool:
        """Return whether more than half of the ranges are others than before, beam by beam and by the turn of both."""
        if len(self.scan) != len(before.scan) or len(self.scan) < 2:
            return True
        return _is_changed(before.sampled, self.sampled) and self._is_changed_by_more_than_turn(before)

    def _is_changed_by_more_than_turn(self, before: _View) -> bool:
        """Compare each beam with the one that looked that way before the robot turned, of beams at equal steps."""
        (x, y), (next_x, next_y) = self.scan.geometry.directions[:2].tolist()
        step = math.atan2(x * next_y - y * next_x, x * next_x + y * next_y)
        turn = math.remainder(float(self.pose[2] - before.pose[2]), math.tau)
        beams = len(self.scan)
        shift = round(turn / step) if abs(turn) < abs(step) * beams else 0
        was = before.sample(max(shift, 0), beams + min(shift, 0))
        return _is_changed(was, self.sample(max(-shift, 0), beams - max(shift, 0)))

    def differs_from(self, before: PolarScan, pose: FloatArray) -> float:
        """How badly the scan agrees with one from before; NaN or infinite where they have too little in common."""
        view = self.polar
        if view is None:
            return math.nan
        return float(disagreements(before, view, move_laser(before, view, between(pose, self.pose)), np.ones(1))[0])

    def is_both_sides_of(self, before: PolarScan, pose: FloatArray) -> bool:
        """Return whether many beams end nearer, and many farther than by the view from before.

        Who passes a door sees farther in most directions, or nearer.
        """
        view = self.polar
        if view is None:
            return False
        ratios = log_ratios_as_reported(before, view, move_laser(before, view, between(pose, self.pose)))
        low, high = np.quantile(ratios, [_MANY, 1 - _MANY]) if len(ratios) else (0.0, 0.0)
        return bool(low < -_SIDE and high > _SIDE)


def _is_changed(was: FloatArray, now: FloatArray) -> bool:
    changed = np.count_nonzero(np.abs(now - was) > _CHANGED_M + _CHANGED * was)
    return bool(changed > _MOST_CHANGED * len(now))


@final
@dataclass(slots=True)
class _Candidate:
    """A scan whose view is another one than that of the scan before, and how those after it differ from both."""

    before: PolarScan
    pose: FloatArray
    first: _View
    latest: _View
    from_before: list[float]
    from_step_to_step: list[float] = field(default_factory=list)

    def watch(self, view: _View) -> bool | None:
        """Return whether the robot was carried, by one scan more; None as long as that is open."""
        self.from_before.append(view.differs_from(self.before, self.pose))
        latest = self.latest.polar
        step = math.nan if latest is None else view.differs_from(latest, self.latest.pose)
        self.from_step_to_step.append(step)
        self.latest = view
        if self.from_before[-1] < _STILL_OTHER:
            return False
        if len(self.from_before) < _WATCHED:
            return None
        is_known = np.count_nonzero(np.isfinite(self.from_before)) >= _FEWEST
        is_one_place = np.count_nonzero(np.array(self.from_step_to_step) < _SAME) >= _MOSTLY * len(
            self.from_step_to_step
        )
        return bool(is_known and is_one_place)


@final
@dataclass(slots=True)
class ViewBreaks:
    """The scans of one laser, compared with those before by the odometry: finds robot_carried.

    Scans cost about 20 microseconds: only where more than half of the ranges change by more than the turn they are
    predicted.

    Attributes
    ----------
    found : list of (float, FloatArray)
        Seconds since the first scan, and the place by the odometry, in the frame of its first pose.
    """

    found: list[tuple[float, FloatArray]] = field(default_factory=list)
    _first: _View | None = None
    _last: _View | None = None
    _agreed: bool = False
    _candidate: _Candidate | None = None

    @property
    def is_open(self) -> bool:
        """Whether the next scans show if the robot was carried."""
        return self._candidate is not None

    def take(self, measurement: Measurement) -> bool:
        """Take the next scan of the laser; return whether it shows that the robot was carried some scans ago."""
        odometry, scan = measurement
        if odometry is None:
            self._last = self._candidate = None
            return False
        view = _View(odometry.pose, scan)
        self._first = self._first or view
        if self._last is not None and view.is_blind_beside(self._last):
            return False  # what is seen next is compared with what was seen before
        if self._candidate is not None:
            carried = self._candidate.watch(view)
            if carried:
                self._note(self._candidate.first)
            self._candidate = self._candidate if carried is None else None
            self._last = view
            return bool(carried)
        self._compare(view)
        self._last = view
        return False

    def _compare(self, view: _View) -> None:
        """Look whether the view is another one than that of the scan before, which agreed with those before it."""
        last, agreed = self._last, self._agreed
        self._agreed = True
        if last is None or not view.is_changed_from(last):
            return
        x, y, turn = between(last.pose, view.pose).tolist()
        moved = max(math.hypot(x, y) / _SMALL_M, abs(turn) / _SMALL_RAD)
        if moved > 1:
            return
        if last.scan.beams(0.0, math.inf).shows_one_thing or view.scan.beams(0.0, math.inf).shows_one_thing:
            return
        before = last.polar
        is_at_once = moved < 0.5 and 0 < view.scan.stamp_ns - last.scan.stamp_ns < 1e9 * _AT_ONCE_S
        if before is None or not (is_at_once or view.is_both_sides_of(before, last.pose)):
            return
        difference = view.differs_from(before, last.pose)
        self._agreed = difference < _SAME
        if agreed and difference > (_STILL_OTHER if is_at_once else _OTHER):
            self._candidate = _Candidate(before, last.pose, view, view, [difference])

    def _note(self, view: _View) -> None:
        if self._first is not None:
            seconds = (view.scan.stamp_ns - self._first.scan.stamp_ns) * 1e-9
            self.found.append((seconds, between(self._first.pose, view.pose)))

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Yield the finding on the laser of that name."""
        if not self.found:
            return
        times = [f"after {at_s:.1f} s at x {place[0]:.2f} m, y {place[1]:.2f} m" for at_s, place in self.found]
        more = f" and {len(times) - _SHOWN} times more" if len(times) > _SHOWN else ""
        yield Finding(
            "robot_carried",
            Severity.ERROR,
            "From one scan to the next the view changes while the odometry is continuous: "
            f"{', '.join(times[:_SHOWN])}{more} (from the first scan, by odometry). The robot was carried there, or "
            "two recordings were joined.",
            self.found[0][0],
            "s",
            "Mapping with loop closure begins a new piece of the map there, and looks for the robot in what was mapped "
            "before.",
            sensor,
        )


def split_where_carried(
    measurements: Iterable[Measurement], on_break: Callable[[Finding], None] = lambda finding: None
) -> Iterator[Iterator[Measurement]]:
    """Yield the measurements of each drive; a new one begins where a laser shows that the robot was carried.

    They come in their order, each drive's before the next one's. Scans are held back as long as it is open whether they
    begin a drive: ten of a laser at most, and only where the view changes.

    Parameters
    ----------
    measurements : iterable of Measurement
        Of one or several lasers.
    on_break : callable
        Gets the finding robot_carried, with all breaks so far, as soon as one more is certain.
    """
    for _, drive in groupby(_number_drives(measurements, on_break), key=itemgetter(0)):
        yield map(itemgetter(1), drive)


def _number_drives(
    measurements: Iterable[Measurement], on_break: Callable[[Finding], None]
) -> Iterator[tuple[int, Measurement]]:
    """Yield each measurement with the number of its drive, once that is certain."""
    numbering = DriveNumbering[Measurement](on_break)
    for measurement in measurements:
        yield from numbering.take(measurement, measurement)
    yield from numbering.end()


@final
class DriveNumbering(Generic[_Item]):
    """Assigns measurements to drives; a new one begins where a laser shows that the robot was carried.

    Parameters
    ----------
    on_break : callable
        Gets the finding robot_carried, with all breaks so far, as soon as one more is certain.
    """

    def __init__(self, on_break: Callable[[Finding], None] = lambda finding: None) -> None:
        """Begin with nothing seen."""
        self._on_break = on_break
        self._breaks: defaultdict[str, ViewBreaks] = defaultdict(ViewBreaks)
        self._held: list[_Item] = []
        self._opened: dict[str, int] = {}  # where in them the view of a laser has changed
        self._number = 0

    def take(self, item: _Item, measurement: Measurement) -> list[tuple[int, _Item]]:
        """Take an item with its measurement; return those whose drive is certain from here on, and its number."""
        sensor = measurement.scan.sensor
        own = self._breaks[sensor]
        is_carried = own.take(measurement)
        self._held.append(item)
        certain: list[tuple[int, _Item]] = []
        if is_carried:
            for finding in own.findings(sensor):
                self._on_break(finding)
            begin = self._opened.get(sensor, 0)  # what was held back for too long has gone already
            certain = [(self._number, before) for before in self._held[:begin]]
            self._number += 1
            del self._held[:begin]
        if is_carried or len(self._held) > _MOST_HELD:  # what the other lasers saw before is of another place
            self._breaks = defaultdict(ViewBreaks, {sensor: own})
            self._opened = {}
        elif own.is_open:
            self._opened.setdefault(sensor, len(self._held) - 1)
        else:
            self._opened.pop(sensor, None)
        return certain if self._opened else [*certain, *self.end()]

    def end(self) -> list[tuple[int, _Item]]:
        """Return the items that were held back: they belong to the drive so far."""
        held, self._held = self._held, []
        self._opened = {}
        return [(self._number, item) for item in held]
