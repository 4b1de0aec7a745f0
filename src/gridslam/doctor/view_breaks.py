"""Detect where a robot was carried: the view changes from one scan to the next while the odometry is continuous."""

from __future__ import annotations

import math
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import chain, groupby, islice
from operator import itemgetter
from typing import Generic, TypeVar, final

import numpy as np

from gridslam.doctor.finding import Finding, Severity
from gridslam.doctor.laser_motion import RANGES_M
from gridslam.doctor.views import OTHER, SAME, View, are_covered, find_similar
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid
from gridslam.matching.gauss_newton import NO_PRIOR, GaussNewton, known_inlier_ratio
from gridslam.types import FloatArray, LaserScan

_Item = TypeVar("_Item")

_SMALL_M = 0.3  # odometry between two scans: after more the view is another one anyway
_SMALL_RAD = 0.3
_AT_ONCE_S = 0.35  # and half of that motion: nobody passes a door that fast, so that all may be farther, or nearer
_STILL_OTHER = 0.15  # and at once; on real logs and among people no alarm was false at 0.12 either
_WATCHED = 10  # scans after a break: who passes closely is gone by then, or the view from before is back
_FEWEST = 8  # of them that have enough in common with the view from before to differ from it
_BEFORE = 8  # scans before the break: in clutter the last one alone may be the odd one
_MOSTLY = 0.75  # of the scans after it that agree with the one before: a laser that fails sees another room in each
_SLIPPED = BranchAndBound(window_m=0.5, window_rad=1.6, min_score=0.1)  # where slipping wheels may have left the robot
_SAME_PLACE = 0.88  # inlier ratio there: of 50 other places in simulated buildings none reached 0.86
_LATE = BranchAndBound(window_m=0.2, window_rad=0.5, min_score=0.1)  # where it is if the odometry comes late
_SAME_PLACE_NEAR = 0.8  # there: on ACES 96 of 100 successive scans in a turn reach it, 1 of 100 pairs of other places
_SHOWN = 5
_MOST_HELD = 100  # scans: a laser that falls silent decides nothing
_BLOCK = 64  # scans that are read, and compared, at once


@final
@dataclass(slots=True)
class _Candidate:
    """A scan whose view is another one than that of the scan before, and how those after it differ from both.

    `before` are the views until then, the last one last, `after` the others.
    """

    before: tuple[View, ...]
    after: list[View]
    from_before: list[float]
    from_step_to_step: list[float] = field(default_factory=list)

    def watch(self, view: View) -> bool | None:
        """Return whether the robot was carried, by one scan more; None as long as that is open."""
        self.from_before.append(view.differs_from(self.before[-1]))
        self.from_step_to_step.append(view.differs_from(self.after[-1]))
        self.after.append(view)
        if self.from_before[-1] < _STILL_OTHER:
            return False
        if len(self.from_before) < _WATCHED:
            return None
        is_known = np.count_nonzero(np.isfinite(self.from_before)) >= _FEWEST
        is_one_place = np.count_nonzero(np.array(self.from_step_to_step) < SAME) >= _MOSTLY * len(
            self.from_step_to_step
        )
        return bool(is_known and is_one_place) and not self._was_seen() and not self._fits_nearby()

    def _was_seen(self) -> bool:
        """Return whether most of the views after the break agree with one of those before it."""
        differences = np.array([[after.differs_from(before) for after in self.after] for before in self.before])
        return bool((np.count_nonzero(differences < _STILL_OTHER, axis=1) > len(self.after) / 2).any())

    def _fits_nearby(self) -> bool:
        """Return whether a scan fits the one before near where odometry has it: wheels slip, and readings come late.

        For a late reading the first two scans after the change are tried, as people may cover the walls in one of them.
        """
        before, (first, second, *_) = self.before[-1], self.after
        maps, row = OccupancyGridMapping().empty(1), np.zeros(1, np.int32)
        maps.update(row, np.zeros((1, 3)), before.scan.beams(*RANGES_M))
        pyramid, matcher = Pyramid.of(maps, 0), GaussNewton()

        def fits(after: View, window: BranchAndBound, least: float) -> bool:
            beams = after.scan.beams(*RANGES_M)
            place = window.search(pyramid, between(before.pose, after.pose), None, beams.ends)
            if place is None:
                return False
            (pose,) = matcher(maps, row, place.pose[None], NO_PRIOR[None], beams).poses
            return known_inlier_ratio(maps, row, pose, beams.ends, matcher.cauchy_m) >= least

        is_late = fits(first, _LATE, _SAME_PLACE_NEAR) or fits(second, _LATE, _SAME_PLACE_NEAR)
        return is_late or fits(first, _SLIPPED, _SAME_PLACE)


@final
@dataclass(slots=True)
class ViewBreaks:
    """The scans of one laser, compared with those before by the odometry: finds robot_carried.

    Only where more than half of the ranges change by more than the turn scans are predicted.

    Attributes
    ----------
    found : list of (float, FloatArray)
        Seconds since the first scan, and the place by the odometry, in the frame of its first pose.
    """

    found: list[tuple[float, FloatArray]] = field(default_factory=list)
    _first: View | None = None
    _recent: deque[View] = field(default_factory=lambda: deque(maxlen=_BEFORE))
    _agreed: bool = False
    _candidate: _Candidate | None = None

    @property
    def is_open(self) -> bool:
        """Whether the next scans show if the robot was carried."""
        return self._candidate is not None

    def take(self, measurement: Measurement, similar: LaserScan | None = None) -> bool:
        """Take the next scan of the laser; return whether it shows that the robot was carried some scans ago.

        `similar` is a scan that is known to be similar (see `find_similar`): they are not compared again.
        """
        odometry, scan = measurement
        if odometry is None:
            self._recent.clear()
            self._candidate = None
            return False
        view = View(odometry.pose, scan)
        self._first = self._first or view
        is_compared = bool(self._recent) and self._recent[-1].scan is not similar
        if is_compared and are_covered(self._recent[-1].measured, view.measured):
            return False  # what is seen next is compared with what was seen before
        before = tuple(self._recent) if is_compared else ()
        self._recent.append(view)
        if self._candidate is None:
            self._compare(before, view)
            return False
        carried = self._candidate.watch(view)
        if carried:
            begin = self._candidate.after[0]
            seconds = (begin.scan.stamp_ns - self._first.scan.stamp_ns) * 1e-9
            self.found.append((seconds, between(self._first.pose, begin.pose)))
        self._candidate = self._candidate if carried is None else None
        return bool(carried)

    def _compare(self, before: tuple[View, ...], view: View) -> None:
        """Look whether the view is another one than that of the scan before, which agreed with those before it."""
        agreed, self._agreed = self._agreed, True
        if not before or not view.is_changed_from(last := before[-1]):
            return
        x, y, turn = between(last.pose, view.pose).tolist()
        moved = max(math.hypot(x, y) / _SMALL_M, abs(turn) / _SMALL_RAD)
        if moved > 1:
            return
        if last.scan.beams(0.0, math.inf).shows_one_thing or view.scan.beams(0.0, math.inf).shows_one_thing:
            return
        is_at_once = moved < 0.5 and 0 < view.scan.stamp_ns - last.scan.stamp_ns < 1e9 * _AT_ONCE_S
        if last.polar is None or not (is_at_once or view.is_both_sides_of(last)):
            return
        difference = view.differs_from(last)
        self._agreed = difference < SAME
        if agreed and difference > (_STILL_OTHER if is_at_once else OTHER):
            self._candidate = _Candidate(before, [view], [difference])

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

    They come in their order, each drive's before the next one's. Blocks of 64 scans are read and compared at once.
    Beyond that scans are held back as long as it is open whether they begin a drive: ten of a laser at most, and only
    where the view changes.

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
    stream = iter(measurements)
    while block := list(islice(stream, _BLOCK)):
        taken = map(numbering.take, block, block, find_similar([scan for _, scan in block]))
        yield from list(chain.from_iterable(taken))  # all ahead of the filter's steps, not one between two of them
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

    def take(self, item: _Item, measurement: Measurement, similar: LaserScan | None = None) -> list[tuple[int, _Item]]:
        """Take an item with its measurement; return those whose drive is certain from here on, and its number.

        `similar` is as for `ViewBreaks.take`.
        """
        sensor = measurement.scan.sensor
        own = self._breaks[sensor]
        is_carried = own.take(measurement, similar)
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
