"""Conversion of measurements to CARMEN, and the data that CARMEN cannot represent."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry import se3
from gridslam.io.carmen.lasers import SICK_NO_RETURN_M
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry

__all__ = ["to_carmen_form"]

_SENSORS = "front", "rear"
_MOST_GEOMETRIES = 256


def to_carmen_form(measurements: Iterable[Measurement], lost: Counter[str]) -> Iterator[Measurement]:
    """Change measurements so that `write_carmen` can write them; what is lost is counted, in scans, by its name.

    A laser that is level but upside down, clockwise or not symmetric about its axis becomes one that is upright,
    counter-clockwise and symmetric, with the very same beams. Scans without odometry after one with odometry are left
    out; odometry takes the scan's stamp.

    Raises
    ------
    ArgumentError
        For what has no such form: a laser that is tilted, beams not evenly spread, more than two lasers.
    """
    lasers, posed, odometry_began = _Lasers(), None, False
    for odometry, scan in measurements:
        posed = odometry is not None if posed is None else posed
        if odometry is None and odometry_began:
            lost["scans without odometry"] += 1
            continue
        odometry_began = odometry_began or odometry is not None
        yield Measurement(_odometry(odometry, scan, lost) if posed else odometry, lasers.form(scan, lost))


def _odometry(odometry: Odometry | None, scan: LaserScan, lost: Counter[str]) -> Odometry | None:
    if odometry is None:
        return None
    lost["more than 6 decimals of poses"] += _rounds(1e6 * odometry.pose, 1e-3)
    if odometry.stamp_ns == scan.stamp_ns:
        return odometry
    lost["the odometry's own stamps"] += 1
    return Odometry(scan.stamp_ns, odometry.pose, odometry.covariance)


@final
class _Lasers:
    """Names and geometries of the lasers, decided once for each."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}
        self._geometries: dict[int, tuple[ScanGeometry, ScanGeometry, bool]] = {}

    def form(self, scan: LaserScan, lost: Counter[str]) -> LaserScan:
        name = self._name(scan.sensor)
        lost[f"the name of the laser ({scan.sensor} is {name} now)"] += name != scan.sensor
        lost["times of beams"] += scan.beam_times_s is not None
        geometry, backward = self._geometry(scan.geometry)
        ranges, status = scan.ranges, scan.status
        if backward:
            ranges, status = ranges[::-1], status[::-1]
        hit = status == BeamStatus.HIT
        far = hit & (ranges >= SICK_NO_RETURN_M)
        if far.any():
            lost[f"ranges from {SICK_NO_RETURN_M} m on"] += 1
            status = np.where(far, np.uint8(BeamStatus.NO_RETURN), status)
        lost["more than 3 decimals of ranges"] += _rounds(1e3 * ranges[hit & ~far], 1e-6)
        return replace(scan, ranges=ranges, status=status, geometry=geometry, sensor=name, beam_times_s=None)

    def _name(self, sensor: str) -> str:
        if sensor not in self._names:
            free = [name for name in _SENSORS if name not in self._names.values()]
            if not free:
                raise ArgumentError("measurements", "two lasers at most (choose with --scan)", [*self._names, sensor])
            self._names[sensor] = sensor if sensor in free else free[0]
        return self._names[sensor]

    def _geometry(self, geometry: ScanGeometry) -> tuple[ScanGeometry, bool]:
        """The same beams in the form that a log's parameters can state, and whether their order is reversed."""
        known = self._geometries.get(id(geometry))
        if known is None:
            if len(self._geometries) >= _MOST_GEOMETRIES:
                self._geometries.clear()
            known = self._geometries[id(geometry)] = geometry, *_symmetric(geometry)
        return known[1:]


def _rounds(values: FloatArray, tolerance: float) -> bool:
    return bool((abs(values - np.rint(values)) > tolerance).any())


def _symmetric(geometry: ScanGeometry) -> tuple[ScanGeometry, bool]:
    """A level geometry as an upright, counter-clockwise one that is symmetric about its axis."""
    bearings, rotation = geometry.bearings, geometry.base_from_laser[:3, :3]
    upright, backward = rotation[2, 2] > 0, False
    if not upright:  # seen from above the beams run the other way
        bearings = -bearings
    if abs(abs(rotation[2, 2]) - 1) > 1e-6:
        tilt = se3.tilt_rad(geometry.base_from_laser)
        got = f"one tilted by {math.degrees(min(tilt, math.pi - tilt)):.1f} degrees"
        raise ArgumentError("base_from_laser", "a laser mounted level, upright or upside down", got)
    if bearings[-1] < bearings[0]:
        bearings, backward = bearings[::-1], True
    if upright and not backward and _has_carmen_form(bearings):
        return geometry, False
    middle = (bearings[0] + bearings[-1]) / 2
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0]) + middle
    return ScanGeometry.planar(bearings - middle, [*geometry.origin, yaw]), backward


def _has_carmen_form(bearings: FloatArray) -> bool:
    """Whether the beams lie about the axis as CARMEN has them: from -fov/2 on, with or without the last edge."""
    n = len(bearings)
    if n == 1:
        return bool(bearings[0] == 0)
    step, fov = float(bearings[-1] - bearings[0]) / (n - 1), -2 * float(bearings[0])
    return fov > 0 and abs(step * n - fov) <= 1.4 * step
