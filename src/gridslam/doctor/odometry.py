"""Odometry checks without scan matching: missing, jumping, frozen, standing still."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias, final

import numpy as np

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.doctor.views import are_changed
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, LaserScan

_WINDOW_S = 1.0
_STILL = 0.01  # m, and rad, more than encoders flicker; in a second slower than any robot drives
_FEWEST_BEAMS = 20
_FROZEN_WINDOWS = 3  # a shorter stop of the wheels' messages is what matching is for
_FROZEN_SHARE = 0.1  # of the time: from here on the map is unusable
_NEVER_MOVED = 0.5  # m, and rad
_LEAP_M = 1.0  # between scans, and faster than any robot with wheels that maps by a planar laser:
_LEAP_RAD = 1.0
_LEAP_M_S = 10.0
_LEAP_RAD_S = 12.0
_CREEPS_M_S = 0.003  # slower than any robot drives; one that stops for each scan is faster, too
_FEWEST_MOVES = 20  # between scans, from which on their speeds show the unit
_LEAST_S = 0.05  # between scans whose stamps jitter, go back or repeat

_Place: TypeAlias = tuple[float, float, float]  # x m, y m, theta rad


@final
@dataclass(slots=True)
class OdometryExaminer:
    """Finds no_odometry, stamp_units, odometry_jumps, odometry_frozen and standing_still.

    Counts way and turns, without those of jumps.
    """

    metres: float = 0.0
    radians: float = 0.0
    scans: int = 0
    without: int = 0
    _first_ns: int | None = None
    _last: tuple[int, _Place] | None = None
    _jumps: list[tuple[float, float, float]] = field(default_factory=list)  # s, m, rad
    _speeds: array[float] = field(default_factory=lambda: array("d"))
    _window: tuple[_Place, LaserScan] | None = None
    _frozen: int = 0
    _frozen_s: float = 0.0
    _watched_s: float = 0.0

    def take(self, measurement: Measurement) -> None:
        """Look at the odometry of the next scan."""
        odometry, scan = measurement
        self.scans += 1
        if odometry is None:
            self.without += 1
            self._last = self._window = None
        else:
            place = tuple(odometry.pose.tolist())
            self._note_way(scan.stamp_ns, place)
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
        if moved > max(_LEAP_M, _LEAP_M_S * seconds) or turned > max(_LEAP_RAD, _LEAP_RAD_S * seconds):
            self._jumps.append(((stamp_ns - self._first_ns) * 1e-9, moved, turned))
        else:
            self.metres += moved
            self.radians += turned

    def _note_window(self, scan: LaserScan, place: _Place) -> None:
        """Compare odometry and ranges with those of a second ago."""
        self._window = start, first = self._window or (place, scan)
        seconds = (scan.stamp_ns - first.stamp_ns) * 1e-9
        if seconds >= _WINDOW_S and scan.sensor == first.sensor:
            self._window = (place, scan)
            self._watched_s += seconds
            if max(_motion(start, place)) < _STILL and _is_changed(first, scan):
                self._frozen += 1
                self._frozen_s += seconds

    def findings(self) -> Iterator[Finding]:
        """Yield the findings on the odometry, and on how the robot was driven."""
        if self.without:
            yield self._no_odometry()
        speed = float(np.median(self._speeds)) if len(self._speeds) >= _FEWEST_MOVES else math.nan
        if self._jumps:
            yield self._odometry_jumps()
        if speed < _CREEPS_M_S:
            yield self._stamp_units(speed)
        if self._frozen >= _FROZEN_WINDOWS:
            yield self._odometry_frozen()
        known = 0 if self._jumps or self._frozen else self.scans - self.without
        if known > _FEWEST_MOVES and max(self.metres, self.radians) < _NEVER_MOVED:
            yield Finding(
                "standing_still",
                Severity.WARNING,
                f"The robot never moves (odometry: {self.metres:.2f} m): there is only one view to map.",
                self.metres,
                "m",
                "Record while the robot drives.",
            )

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
        return Finding(
            "odometry_frozen",
            Severity.ERROR if self._frozen_s > _FROZEN_SHARE * self._watched_s else Severity.WARNING,
            f"For {self._frozen_s:.0f} of {self._watched_s:.0f} s odometry stood still while the scans changed: it is "
            "frozen.",
            self._frozen_s,
            "s",
            "Look for what stops odometry on the robot; map with --no-odometry until then.",
        )


def _is_changed(before: LaserScan, after: LaserScan) -> bool:
    """Return whether most beams with two hits have other ranges."""
    if len(before) != len(after):
        return False
    both = (before.status == BeamStatus.HIT) & (after.status == BeamStatus.HIT)
    return bool(both.sum() >= _FEWEST_BEAMS and are_changed(before.ranges[both], after.ranges[both]))


def _motion(before: _Place, after: _Place) -> tuple[float, float]:
    """Return metres and radians between two poses, both positive."""
    return math.dist(before[:2], after[:2]), abs((after[2] - before[2] + math.pi) % math.tau - math.pi)
