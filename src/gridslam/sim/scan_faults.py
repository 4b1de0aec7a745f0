"""Faults of a laser and of how it is mounted: streams of measurements in, the same with one fault out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, LaserScan, ScanGeometry

__all__ = [
    "beam_count_varies", "invalid_beams", "range_limits", "reflected_laser", "tilted_laser", "tilting_laser",
    "yaw_offset",
]  # fmt: skip

_CEILING_M = 2.5


def reflected_laser(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    """Ranges come in reverse order, each with its own time, and the log does not know.

    What a laser looks like that turns clockwise or is mounted upside-down, where nothing tells so.
    """
    for odometry, scan in measurements:
        times = None if scan.beam_times_s is None else scan.beam_times_s[::-1].copy()
        ranges, status = scan.ranges[::-1].copy(), scan.status[::-1].copy()
        yield Measurement(odometry, replace(scan, ranges=ranges, status=status, beam_times_s=times))


def yaw_offset(measurements: Iterable[Measurement], yaw_rad: float) -> Iterator[Measurement]:
    """The laser is mounted `yaw_rad` rad farther to the left than the log tells; pi: it looks backward."""
    geometries: dict[ScanGeometry, ScanGeometry] = {}
    for odometry, scan in measurements:
        if (told := geometries.get(scan.geometry)) is None:
            mounting = scan.geometry.base_from_laser @ _rotation(2, -yaw_rad)
            told = geometries[scan.geometry] = ScanGeometry(scan.geometry.bearings, mounting)
        yield Measurement(odometry, replace(scan, geometry=told))


def beam_count_varies(
    measurements: Iterable[Measurement], fewer: float, rng: np.random.Generator
) -> Iterator[Measurement]:
    """Of each scan the last 0 to `fewer` beams are missing, another number each time: 460 beams with 6 are 454 to 460.

    Angles and times of the others are right. At least one beam is left; `fewer` is a whole number.
    """
    geometries: dict[tuple[ScanGeometry, int], ScanGeometry] = {}
    for odometry, scan in measurements:
        count = max(1, len(scan) - int(rng.integers(0, int(fewer) + 1)))
        if (geometry := geometries.get((scan.geometry, count))) is None:
            geometry = ScanGeometry(scan.geometry.bearings[:count], scan.geometry.base_from_laser)
            geometries[scan.geometry, count] = geometry
        times = None if scan.beam_times_s is None else scan.beam_times_s[:count]
        ranges, status = scan.ranges[:count], scan.status[:count]
        yield Measurement(
            odometry, replace(scan, ranges=ranges, status=status, geometry=geometry, beam_times_s=times)
        )


def invalid_beams(measurements: Iterable[Measurement], share: float, rng: np.random.Generator) -> Iterator[Measurement]:
    """Each beam is NaN with probability `share`, in [0, 1]."""
    for odometry, scan in measurements:
        ranges = np.where(rng.random(len(scan)) < share, np.nan, scan.ranges)
        yield Measurement(odometry, _measured(scan, ranges, scan.geometry, scan.range_max_m))


def range_limits(measurements: Iterable[Measurement], factor: float) -> Iterator[Measurement]:
    """Scans tell `factor` times their true greatest range.

    Above 1 a beam without return, reported as the true greatest range, reads as a wall there; below 1 walls beyond the
    told range read as no return.
    """
    for odometry, scan in measurements:
        yield Measurement(odometry, _measured(scan, scan.ranges, scan.geometry, factor * scan.range_max_m))


def tilted_laser(measurements: Iterable[Measurement], tilt_rad: float, height_m: float = 0.3) -> Iterator[Measurement]:
    """The laser is tilted by `tilt_rad` rad, nose down, and the log tells that it is level.

    From `height_m` m above the floor it sees the floor where that is nearer than the walls, or with its nose up the
    ceiling, 2.5 m high. Walls are as high as the room, and known from the level scan, between whose beams the inverse
    range is interpolated.
    """
    for odometry, scan in measurements:
        yield Measurement(odometry, _tilted(scan, tilt_rad, height_m, scan.geometry))


def tilting_laser(
    measurements: Iterable[Measurement], amplitude_rad: float, period_s: float = 4.0, height_m: float = 0.3
) -> Iterator[Measurement]:
    """The laser nods by `amplitude_rad` rad up and down, and each scan tells its true mounting: no 2D log.

    What it sees is as of `tilted_laser`.
    """
    for odometry, scan in measurements:
        tilt = amplitude_rad * math.sin(math.tau * scan.stamp_ns * 1e-9 / period_s)
        mounting = scan.geometry.base_from_laser @ _rotation(1, tilt)
        yield Measurement(odometry, _tilted(scan, tilt, height_m, ScanGeometry(scan.geometry.bearings, mounting)))


def _tilted(scan: LaserScan, tilt: float, height_m: float, told: ScanGeometry) -> LaserScan:
    """What the laser of a level scan sees after a rotation about its y axis, from the rays' horizontal bearings."""
    bearings = scan.geometry.bearings
    forward, aside = np.cos(bearings) * math.cos(tilt), np.sin(bearings)
    down = np.cos(bearings) * math.sin(tilt)
    order = np.argsort(bearings)
    level = 1 / np.interp(np.arctan2(aside, forward), bearings[order], 1 / scan.ranges[order])
    flat = np.where(down > 0, height_m, height_m - _CEILING_M) / np.where(down == 0, 1e-9, down)
    ranges = np.minimum(level / np.hypot(forward, aside), np.abs(flat))
    return _measured(scan, np.minimum(ranges, scan.range_max_m), told, scan.range_max_m)


def _measured(scan: LaserScan, ranges: FloatArray, geometry: ScanGeometry, range_max_m: float) -> LaserScan:
    """Build the same scan from other ranges, angles and limits."""
    return LaserScan.from_ranges(
        scan.stamp_ns, ranges, geometry, range_min_m=scan.range_min_m, range_max_m=range_max_m, sensor=scan.sensor,
        frame=scan.frame, beam_times_s=scan.beam_times_s,
    )  # fmt: skip


def _rotation(axis: int, angle: float) -> FloatArray:
    """Rotation (4, 4) about the y axis (1), where positive angles lower the x axis, or about the z axis (2)."""
    c, s = math.cos(angle), math.sin(angle)
    if axis == 1:
        return np.array([[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0], [0.0, 0.0, 0.0, 1.0]])
    return np.array([[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
