"""Odometry checks without scan matching: missing, jumping, frozen, standing still, turning too fast."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias, final

import numpy as np

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.doctor.range_units import UNITS
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, LaserScan

_WINDOW_S = 1.0
_STILL = 0.01  # m, and rad, in a second: slower than any robot drives, more than encoders flicker
_CHANGED_M = 0.1  # change of a range above noise, and
_CHANGED_SHARE = 0.02  # of the range
_MOST_CHANGED = 0.5  # of the beams: people who pass change fewer
_FROZEN_WINDOWS = 3  # a shorter stop of the wheels' messages is what matching is for
_FROZEN_SHARE = 0.1  # of the time: from here on the map is unusable
_STILL_WORTH_S = 10.0  # seconds that are worth a line
_MOSTLY_STILL = 0.5  # of the time
_NEVER_MOVED = 0.5  # m, and rad
_LEAP_M = 1.0  # between scans, and faster than any robot with wheels that maps by a planar laser:
_LEAP_RAD = 1.0
_LEAP_M_S = 10.0
_LEAP_RAD_S = 12.0
_UNITS = {name: of_a_metre for name, of_a_metre in UNITS.items() if of_a_metre > 10}
_CREEPS_M_S = 0.003  # slower than any robot drives; one that stops for each scan is faster, too
_SPEEDS_M_S = (0.1, 2.0)  # at which robots are driven while they map
_FEWEST_MOVES = 20  # between scans, from which on their speeds show the unit
_LEAST_S = 0.05  # between scans whose stamps jitter, go back or repeat
_OVERLAP = 0.5  # share of the field of view that two scans that follow each other must have in common
_GUESS_RAD = 1.0  # odometry errs by 5 % of a turn: 0.5 m at 10 m, as far as matching reaches
_FAST_SHARE = 0.005  # of all scans: from one in 200 on it is how the robot drives, not a hitch

_Place: TypeAlias = tuple[float, float, float]  # x m, y m, theta rad


@final
@dataclass(slots=True)
class OdometryExaminer:
    """Finds no_odometry, odometry_units, stamp_units, odometry_jumps, odometry_frozen, standing_still, fast_turning.

    Counts way and turns, without those of jumps.
    """

    metres: float = 0.0
    radians: float = 0.0
    scans: int = 0
    without: int = 0
    _fastest_rad: float = 0.0
    _fields: dict[str, float] = field(default_factory=dict)
    _too_far: Counter[str] = field(default_factory=Counter)
    _previous: dict[str, _Place] = field(default_factory=dict)
    _first_ns: int | None = None
    _last: tuple[int, _Place] | None = None
    _jumps: list[tuple[float, float, float]] = field(default_factory=list)  # s, m, rad
    _speeds: array[float] = field(default_factory=lambda: array("d"))
    _window: tuple[_Place, LaserScan] | None = None
    _frozen: int = 0
    _watched_s: float = 0.0
    _still_s: float = 0.0
    _frozen_s: float = 0.0

    def take(self, measurement: Measurement) -> None:
        """Look at the odometry of the next scan."""
        odometry, scan = measurement
        self.scans += 1
        if odometry is None:
            self.without += 1
            self._last = None
            self._window = None
            self._previous.pop(scan.sensor, None)
            return
        place = tuple(odometry.pose.tolist())
        self._note_way(scan.stamp_ns, place)
        self._note_turn(scan, place)
        self._note_window(scan, place)

    def _note_way(self, stamp_ns: int, place: _Place) -> None:
        """Add path length and rotation since the last scan, or record a jump that is faster than a robot can move."""
        last_ns, before = self._last or (stamp_ns, place)
        self._last = (stamp_ns, place)
        if self._first_ns is None:
            self._first_ns = stamp_ns
        moved, turned = _motion(before, place)
        seconds = max((stamp_ns - last_ns) * 1e-9, _LEAST_S)
        if moved > _STILL:
            self._speeds.append(moved / seconds)
        if is_jump(moved, turned, seconds):
            self._jumps.append(((stamp_ns - self._first_ns) * 1e-9, moved, turned))
        else:
            self.metres += moved
            self.radians += turned

    def _note_turn(self, scan: LaserScan, place: _Place) -> None:
        """Compare the rotation since this laser's previous scan with the bound of both scans."""
        before = self._previous.get(scan.sensor)
        self._previous[scan.sensor] = place
        if scan.sensor not in self._fields:
            bearings = scan.geometry.bearings
            self._fields[scan.sensor] = min(float(np.ptp(bearings)), math.tau) if len(bearings) else 0.0
        if before is not None:
            _, turned = _motion(before, place)
            self._too_far[scan.sensor] += turned > self._limit(scan.sensor)
            self._fastest_rad = max(self._fastest_rad, turned)

    def _limit(self, sensor: str) -> float:
        """Turn between two scans from which on they are hard to match, rad; for a single beam there is none."""
        field_rad = self._fields[sensor]
        return min(_GUESS_RAD, _OVERLAP * field_rad) if field_rad else math.inf

    def _note_window(self, scan: LaserScan, place: _Place) -> None:
        """Compare odometry and ranges with those of a second ago."""
        if self._window is None:
            self._window = (place, scan)
            return
        start, first = self._window
        seconds = (scan.stamp_ns - first.stamp_ns) * 1e-9
        if seconds < _WINDOW_S or scan.sensor != first.sensor:
            return
        self._watched_s += seconds
        moved, turned = _motion(start, place)
        if moved < _STILL and turned < _STILL:
            frozen = _share_changed(first, scan) > _MOST_CHANGED
            self._frozen += frozen
            self._frozen_s += frozen * seconds
            self._still_s += (not frozen) * seconds
        self._window = (place, scan)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings on the odometry, and on how the robot was driven."""
        if self.without:
            yield self._no_odometry()
        speed = float(np.median(self._speeds)) if len(self._speeds) >= _FEWEST_MOVES else math.nan
        if speed > _LEAP_M_S:
            yield self._odometry_units(speed)
        elif self._jumps:
            yield self._odometry_jumps()
        if speed < _CREEPS_M_S:
            yield self._stamp_units(speed)
        if self._frozen >= _FROZEN_WINDOWS:
            yield self._odometry_frozen()
        if self._watched_s:
            yield from self._standing_still()
        yield from self._fast_turning()

    def _no_odometry(self) -> Finding:
        share = self.without / self.scans
        message = (
            "There is no odometry: motion is estimated from scans alone, which underestimates long bare corridors."
        )
        remedy = "Record odometry too; until then drive slowly, and map with --no-odometry."
        if share < 1:
            message = f"{self.without} of {self.scans} scans ({percent(share)}) have no odometry."
            remedy = "See to it that odometry is recorded from before the first scan until after the last."
        severity = Severity.WARNING if share > 0.02 else Severity.INFO
        return Finding("no_odometry", severity, message, share, "share", remedy if share > 0.02 else "")

    def _odometry_units(self, speed: float) -> Finding:
        low, high = _SPEEDS_M_S
        units = [name for name, of_a_metre in _UNITS.items() if low <= speed / of_a_metre <= high]
        name = " or ".join(units) or "another unit"
        return Finding(
            "odometry_units",
            Severity.WARNING,
            f"The odometry is in {name}, not in metres: in metres the robot would mostly drive at {speed:.0f} m/s.",
            speed,
            "m/s",
            "Convert the positions to metres where the odometry is computed; map with --no-odometry until then.",
        )

    def _stamp_units(self, speed: float) -> Finding:
        name, of_a_second = ("milliseconds", 1000) if speed > _CREEPS_M_S / 1000 else ("microseconds", 1_000_000)
        return Finding(
            "stamp_units",
            Severity.WARNING,
            f"The stamps look like {name}, read as seconds: by them the robot mostly drives at {speed:.2g} m/s.",
            speed,
            "m/s",
            f"Divide the stamps by {of_a_second} where the log is written.",
        )

    def _odometry_jumps(self) -> Finding:
        at_s, metres, radians = max(self._jumps, key=lambda jump: jump[1] / _LEAP_M + jump[2] / _LEAP_RAD)
        often = "once" if len(self._jumps) == 1 else f"{len(self._jumps)} times, most"
        size = (metres, "m") if metres > _LEAP_M else (radians, "rad")
        return Finding(
            "odometry_jumps",
            Severity.WARNING,
            f"Odometry jumps {often} by {metres:.4g} m and {radians:.2f} rad after {at_s:.1f} s: no robot moves this "
            "fast from one scan to the next. The odometry was reset, or a reading is wrong.",
            *size,
            "Look for what restarts or corrects the odometry; in a jump the motion is estimated from scans.",
        )

    def _odometry_frozen(self) -> Finding:
        share = self._frozen_s / self._watched_s
        return Finding(
            "odometry_frozen",
            Severity.ERROR if share > _FROZEN_SHARE else Severity.WARNING,
            f"For {self._frozen_s:.0f} of {self._watched_s:.0f} s odometry stood still while the scans changed: it is "
            "frozen.",
            self._frozen_s,
            "s",
            "Look for what stops odometry on the robot; map with --no-odometry until then.",
        )

    def _standing_still(self) -> Iterator[Finding]:
        share = self._still_s / self._watched_s
        never = self.metres < _NEVER_MOVED and self.radians < _NEVER_MOVED and not self._frozen
        if never and share > _MOSTLY_STILL:
            message = f"The robot never moves (odometry: {self.metres:.2f} m): there is only one view to map."
            remedy = "Record while the robot drives."
            yield Finding("standing_still", Severity.WARNING, message, self._still_s, "s", remedy)
        elif self._still_s > _STILL_WORTH_S:
            message = (
                f"The robot stands still for {self._still_s:.0f} s, {percent(share)} of the time, which is harmless."
            )
            yield Finding("standing_still", Severity.INFO, message, self._still_s, "s")

    def _fast_turning(self) -> Iterator[Finding]:
        for sensor, count in self._too_far.items():
            if count < 3 or count <= _FAST_SHARE * self.scans:
                continue
            limit = self._limit(sensor)
            yield Finding(
                "fast_turning",
                Severity.WARNING,
                f"The robot turns by up to {self._fastest_rad:.2f} rad from one scan to the next, and by more than "
                f"{limit:.2f} rad before {count} of {self.scans} scans: too little is seen in both.",
                self._fastest_rad,
                "rad",
                "Turn more slowly, or let the laser scan faster.",
                sensor,
            )


def is_jump(metres: float, radians: float, seconds: float) -> bool:
    """Return whether no robot moves so far, or turns so much, between scans of this distance in time."""
    seconds = max(seconds, _LEAST_S)
    return metres > max(_LEAP_M, _LEAP_M_S * seconds) or radians > max(_LEAP_RAD, _LEAP_RAD_S * seconds)


def _motion(before: _Place, after: _Place) -> tuple[float, float]:
    """Return metres and radians between two poses, both positive."""
    return math.dist(before[:2], after[:2]), abs((after[2] - before[2] + math.pi) % math.tau - math.pi)


def _share_changed(before: LaserScan, after: LaserScan) -> float:
    """Return ratio of beams with two hits whose ranges differ by more than noise; 0 if there are too few."""
    if len(before) != len(after):
        return 0.0
    both = (before.status == BeamStatus.HIT) & (after.status == BeamStatus.HIT)
    old = before.ranges[both]
    if len(old) < 20:
        return 0.0
    return float(np.mean(np.abs(after.ranges[both] - old) > _CHANGED_M + _CHANGED_SHARE * old))
