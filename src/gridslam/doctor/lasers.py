"""Reported mounting of each laser: several, tilted, tilting."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import final

import numpy as np

from gridslam.doctor.finding import Finding, Severity
from gridslam.geometry.angles import wrap
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, ScanGeometry

__all__ = ["LaserExaminer", "Mounted"]

_TILTS_RAD = math.radians(1.0)  # vibration of a stiff mount stays below it; a laser that is made to tilt does not
_NEAR_FLOOR_M = 8.0  # a beam that meets the floor nearer than most walls are draws the floor as a wall
_SAME_M, _SAME_RAD = 1e-3, 1e-3


@final
@dataclass(slots=True)
class Mounted:
    """The mounting of one laser, over all its scans."""

    geometry: ScanGeometry
    scans: int = 0
    _lowest: FloatArray = field(default_factory=lambda: np.full(2, np.inf))
    _highest: FloatArray = field(default_factory=lambda: np.full(2, -np.inf))

    def take(self, geometry: ScanGeometry) -> None:
        """Take the next scan's geometry."""
        if self.scans == 0 or geometry is not self.geometry:
            upright = geometry.base_from_laser[:2, 2]
            np.minimum(self._lowest, upright, out=self._lowest)
            np.maximum(self._highest, upright, out=self._highest)
            self.geometry = geometry
        self.scans += 1

    @property
    def amplitude_rad(self) -> float:
        """By how much the laser's axis swings to either side of its middle."""
        half = 0.5 * (self._highest - self._lowest)
        return math.asin(min(1.0, float(np.hypot(*half))))

    @property
    def tilt_rad(self) -> float:
        """Angle between the laser's axis and the vertical, whichever way up it is."""
        return math.acos(min(1.0, abs(float(self.geometry.base_from_laser[2, 2]))))

    @property
    def upside_down(self) -> bool:
        """Whether the laser's axis points down."""
        return bool(self.geometry.base_from_laser[2, 2] < 0)

    @property
    def pose(self) -> FloatArray:
        """Where the laser is on the robot and where bearing 0 points: [x m, y m, yaw rad]."""
        mounting = self.geometry.base_from_laser
        return np.array([mounting[0, 3], mounting[1, 3], math.atan2(mounting[1, 0], mounting[0, 0])])

    def floor_m(self) -> float:
        """Least distance at which a beam meets the floor below the base; infinite where none does."""
        mounting, bearings = self.geometry.base_from_laser, self.geometry.bearings
        falls = -(mounting[2, 0] * np.cos(bearings) + mounting[2, 1] * np.sin(bearings))
        steepest = float(falls.max(initial=0.0))
        height = float(mounting[2, 3])
        return height / steepest if height > 0 and steepest > 1e-6 else math.inf


@final
class LaserExaminer:
    """Finds several_lasers and tilting_laser."""

    def __init__(self) -> None:
        """Begin with no laser seen."""
        self.lasers: dict[str, Mounted] = {}

    def take(self, measurement: Measurement) -> None:
        """Look at the mounting of the next scan."""
        scan = measurement.scan
        laser = self.lasers.get(scan.sensor)
        if laser is None:
            laser = self.lasers[scan.sensor] = Mounted(scan.geometry)
        laser.take(scan.geometry)

    def findings(self) -> Iterator[Finding]:
        """Yield the findings on the lasers."""
        if len(self.lasers) > 1:
            yield self._several()
        for sensor, laser in self.lasers.items():
            if laser.amplitude_rad > _TILTS_RAD:
                yield _tilting(sensor, laser.amplitude_rad)
            elif laser.floor_m() < _NEAR_FLOOR_M:
                yield _tilted(sensor, laser)

    def _several(self) -> Finding:
        poses = [laser.pose for laser in self.lasers.values()]
        away = [(pose - poses[0])[:2] for pose in poses[1:]]
        turned = [abs(float(wrap(pose[2] - poses[0][2]))) for pose in poses[1:]]
        same = any(np.hypot(*d) < _SAME_M and t < _SAME_RAD for d, t in zip(away, turned, strict=True))
        told = "; ".join(f"{sensor} at {_describe(laser)}" for sensor, laser in self.lasers.items())
        message = f"There are {len(poses)} lasers, whose scans are taken in turn: {told}."
        if not same:
            return Finding("several_lasers", Severity.INFO, message, len(poses), "lasers")
        return Finding(
            "several_lasers", Severity.WARNING, f"{message} Two cannot be in one place: a mounting is missing.",
            len(poses), "lasers", "State the mounting of each laser (a static transform to the base), or choose one "
            "laser with --scan.",
        )  # fmt: skip


def _describe(laser: Mounted) -> str:
    x, y, yaw = laser.pose.tolist()
    return f"x {x:.2f} m, y {y:.2f} m, yaw {math.degrees(yaw):.0f} degrees"


def _tilting(sensor: str, amplitude_rad: float) -> Finding:
    return Finding(
        "tilting_laser", Severity.ERROR,
        f"The laser tilts by {math.degrees(amplitude_rad):.1f} degrees to either side while it scans: this is a log of "
        "a 3D sensor, not of a level one.",
        amplitude_rad, "rad", "Hold the laser level and record again, or choose another laser with --scan.", sensor,
    )  # fmt: skip


def _tilted(sensor: str, laser: Mounted) -> Finding:
    return Finding(
        "tilting_laser", Severity.WARNING,
        f"The laser is mounted {math.degrees(laser.tilt_rad):.1f} degrees from level, and its beams meet the floor "
        f"from {laser.floor_m():.1f} m on: the floor is mapped as a wall.",
        laser.tilt_rad, "rad", f"Level the laser, or map with --set range_max_m={0.95 * laser.floor_m():.1f}.", sensor,
    )  # fmt: skip
