"""Facts about each laser from its scans alone: number, directions and status of its beams, and its mounting."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.finding import Finding, Severity, percent
from gridslam.types import BeamStatus, FloatArray, LaserScan, ScanGeometry

_MANY_LOST = 0.1  # ratio of beams lost by ones and twos: the pose's spread grows by 5 %; healthy: some thousandths
_LONGEST_LOSS = 3  # beams: a longer run is a surface, or nothing in reach; beams are lost by chance one by one
_FEW_HITS = 20  # beams: fewer hardly fix x, y and heading against people and clutter
_OFTEN = 0.1  # share of scans with few hits from which on the map has holes; and half of them leaves no map

_TILTS_RAD = math.radians(1.0)  # vibration of a stiff mount stays below it; a laser that is made to tilt does not
_STEEP_RAD = math.radians(30.0)  # from level: what is seen is no floor plan
_FAR_M = 5.0  # from the base: beyond any robot


def field_of_view_rad(bearings: FloatArray) -> float:
    """Return angle over which beams with bearings (B,) are spread, one step for each beam, at most a full turn."""
    if len(bearings) < 2:
        return 0.0
    return min(abs(float(bearings[-1] - bearings[0])) * len(bearings) / (len(bearings) - 1), math.tau)


def planar_mounting(geometry: ScanGeometry) -> FloatArray:
    """Return where a laser is in the base frame and where bearing 0 points: [x m, y m, yaw rad]."""
    mounting = geometry.base_from_laser
    return np.array([mounting[0, 3], mounting[1, 3], math.atan2(mounting[1, 0], mounting[0, 0])])


@final
@dataclass(slots=True)
class BeamStatistics:
    """The beams of one laser: finds beam_count_varies, invalid_beams, few_hits and single_object."""

    scans: int = 0
    counts: Counter[int] = field(default_factory=Counter)
    beams: int = 0
    invalid: int = 0
    no_return: int = 0
    scattered: int = 0
    scans_without_hits: int = 0
    scans_of_one_thing: int = 0
    limits_m: tuple[float, float] = (0.0, math.inf)

    def take(self, scan: LaserScan) -> None:
        """Take the beams of the next scan."""
        count = len(scan)
        lost = scan.status == BeamStatus.INVALID
        invalid = int(np.count_nonzero(lost))
        hits = int(np.count_nonzero(scan.status == BeamStatus.HIT))
        self.counts[count] += 1
        self.beams += count
        self.invalid += invalid
        self.no_return += count - invalid - hits
        self.limits_m = scan.range_min_m, scan.range_max_m
        self.scans_without_hits += hits < _FEW_HITS
        self.scans_of_one_thing += 0 < 2 * hits < count and scan.beams(0.0, math.inf).shows_one_thing
        self.scans += 1
        edges = np.flatnonzero(np.diff(lost, prepend=False, append=False))
        runs = edges[1::2] - edges[::2]
        self.scattered += int(runs[runs <= _LONGEST_LOSS].sum())

    @property
    def usual_count(self) -> int:
        """The number of beams that most scans have."""
        return self.counts.most_common(1)[0][0] if self.counts else 0

    @property
    def often_shows_one_thing(self) -> bool:
        """Whether all that is seen in many scans may be a person: such a laser is no reference for a motion."""
        return self.scans_of_one_thing > _OFTEN * self.scans

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Yield the findings on the beams of the laser of that name."""
        if len(self.counts) > 1:
            yield self._varies(sensor)
        if self.invalid:
            yield self._invalid(sensor)
        if self.scans_without_hits > _OFTEN * self.scans:
            yield self._few_hits(sensor)
        if self.often_shows_one_thing:
            yield self._single_object(sensor)

    def _varies(self, sensor: str) -> Finding:
        least = min(self.counts)
        most = max(self.counts)
        return Finding(
            "beam_count_varies",
            Severity.WARNING,
            f"The number of beams varies from {least} to {most}; {self.counts[self.usual_count]} of {self.scans} scans "
            f"have {self.usual_count}.",
            most - least,
            "beams",
            "gridslam uses the angles of each scan: make sure that the driver sets angle_min and angle_increment "
            "for each scan, since a fixed increment with a varying number of beams bends the walls.",
            sensor,
        )

    def _invalid(self, sensor: str) -> Finding:
        share = self.invalid / self.beams
        scattered = self.scattered / self.beams
        many = scattered > _MANY_LOST
        message = f"{percent(share)} of the beams are invalid (no number, zero, negative or too near)"
        if many:
            message += (
                f"; {percent(scattered)} are lost by ones and twos among good ones, as where a laser is disturbed"
            )
        elif share > _MANY_LOST:
            message += "; they lie side by side, as where nothing is in reach or the robot hides the view"
        return Finding(
            "invalid_beams",
            Severity.WARNING if many else Severity.INFO,
            message + ".",
            share,
            "share",
            "Clean the laser, and look for what disturbs it: sun, dark or shining surfaces, another laser, a cable."
            if many
            else "",
            sensor,
        )

    def _single_object(self, sensor: str) -> Finding:
        share = self.scans_of_one_thing / self.scans
        return Finding(
            "single_object",
            Severity.WARNING,
            f"In {percent(share)} of the scans all that is seen is one thing of a person's size: what is seen may move "
            "by itself, as a person who is followed. Such scans are not matched, the odometry is taken for them.",
            share,
            "share",
            "Drive where walls are within the laser's reach, and let nobody fill its view.",
            sensor,
        )

    def _few_hits(self, sensor: str) -> Finding:
        share = self.scans_without_hits / self.scans
        return Finding(
            "few_hits",
            Severity.ERROR if share > 0.5 else Severity.WARNING,
            f"{percent(share)} of the scans have fewer than {_FEW_HITS} beams that hit anything "
            f"({percent(self.no_return / max(self.beams, 1))} of all beams return nothing, "
            f"{percent(self.invalid / max(self.beams, 1))} are invalid, by limits of {self.limits_m[0]:g} and "
            f"{self.limits_m[1]:g} m): they cannot be matched.",
            share,
            "share",
            "Drive where walls are within the laser's reach, and check its range limits.",
            sensor,
        )


@final
@dataclass(slots=True)
class Mounting:
    """The geometry of one laser's latest scan, and how its axis tilted over all its scans."""

    geometry: ScanGeometry = field(default_factory=lambda: ScanGeometry(np.zeros(0)))
    _lowest: FloatArray = field(default_factory=lambda: np.full(2, np.inf))
    _highest: FloatArray = field(default_factory=lambda: np.full(2, -np.inf))

    def take(self, geometry: ScanGeometry) -> None:
        """Take the next scan's geometry."""
        if geometry is not self.geometry:
            upright = geometry.base_from_laser[:2, 2]
            np.minimum(self._lowest, upright, out=self._lowest)
            np.maximum(self._highest, upright, out=self._highest)
            self.geometry = geometry

    @property
    def amplitude_rad(self) -> float:
        """By how much the laser's axis swings to either side of its middle."""
        half = 0.5 * (self._highest - self._lowest)
        return math.asin(min(1.0, float(np.hypot(*half))))

    @property
    def tilt_rad(self) -> float:
        """Angle between the laser's axis and the vertical, whichever way up it is."""
        return math.acos(min(1.0, abs(float(self.geometry.base_from_laser[2, 2]))))

    def findings(self, sensor: str) -> Iterator[Finding]:
        """Yield laser_far_away and tilting_laser for the laser of that name."""
        away_m = float(np.hypot(*planar_mounting(self.geometry)[:2]))
        if away_m > _FAR_M:
            yield Finding(
                "laser_far_away",
                Severity.ERROR,
                f"The laser is mounted {away_m:.4g} m away from the robot's base: as in centimetres or millimetres, or "
                "in another frame.",
                away_m,
                "m",
                "State the mounting in metres, as a transform from the robot's base to the laser.",
                sensor,
            )
        if self.amplitude_rad > _TILTS_RAD:
            yield Finding(
                "tilting_laser",
                Severity.ERROR,
                f"The laser tilts by {math.degrees(self.amplitude_rad):.1f} degrees to either side while it scans: "
                "this is a log of a 3D sensor, not of a level one.",
                self.amplitude_rad,
                "rad",
                "Hold the laser level and record again, or choose another laser with --scan.",
                sensor,
            )
        elif self.tilt_rad > _STEEP_RAD:
            yield Finding(
                "tilting_laser",
                Severity.ERROR,
                f"The laser is mounted {math.degrees(self.tilt_rad):.1f} degrees from level, as in the optical frame "
                "of a camera: its scans show no floor plan.",
                self.tilt_rad,
                "rad",
                "State the frame of the scan itself: x ahead, z up, the beams in the plane of x and y.",
                sensor,
            )
