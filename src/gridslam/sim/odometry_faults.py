"""Faults of odometry, and of its clock: streams of measurements in, the same with one fault out."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import tee

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry import se2
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, Odometry

__all__ = ["clock_skew", "odometry_drift", "odometry_rotation_bias", "odometry_scale", "wheel_slip"]

_SLIP_LASTS_S = 1.0
_DRIVES_M_S = 0.05  # a robot slower than this does not slip


def odometry_scale(measurements: Iterable[Measurement], excess: float) -> Iterator[Measurement]:
    """Odometry reports 1 + `excess` m per metre; turns are unchanged. 0.03: wheels 3 % smaller than declared."""
    return _distorted(measurements, lambda twist, _: twist * [1 + excess, 1 + excess, 1.0])


def odometry_rotation_bias(measurements: Iterable[Measurement], excess: float) -> Iterator[Measurement]:
    """Odometry reports 1 + `excess` rad per radian turned: wheels closer together than declared."""
    return _distorted(measurements, lambda twist, _: twist * [1.0, 1.0, 1 + excess])


def odometry_drift(measurements: Iterable[Measurement], bias_rad_per_m: float) -> Iterator[Measurement]:
    """Odometry adds a left turn of `bias_rad_per_m` per metre driven to the true turn: unequal wheels."""
    return _distorted(measurements, lambda twist, _: np.add(twist, [0, 0, bias_rad_per_m * np.hypot(*twist[:2])]))


def wheel_slip(
    measurements: Iterable[Measurement], slip_m: float, rng: np.random.Generator, every_s: float = 20.0
) -> Iterator[Measurement]:
    """In episodes of 1 s odometry reports `slip_m` m more forward motion than was driven: the wheels spin.

    An episode begins by chance, once in `every_s` seconds of driving on the average, and never while one lasts.
    """
    left_s = 0.0

    def slipping(twist: FloatArray, seconds: float) -> FloatArray:
        nonlocal left_s
        drives = np.hypot(*twist[:2]) > _DRIVES_M_S * seconds
        if left_s <= 0 and drives and rng.random() < seconds / every_s:
            left_s = _SLIP_LASTS_S
        spins_s = min(left_s, max(seconds, 0.0))
        left_s -= spins_s
        return np.add(twist, [slip_m * spins_s / _SLIP_LASTS_S, 0, 0])

    return _distorted(measurements, slipping)


def clock_skew(measurements: Iterable[Measurement], skew_s: float) -> Iterator[Measurement]:
    """Scans are stamped `skew_s` s after the time at which they were taken, as read on the odometry's clock.

    A scan comes with the odometry of its wrong stamp, interpolated between readings along an arc. Where it would lie
    beyond all readings the scan is left out, at the end for skew_s > 0 and at the begin for skew_s < 0. Stamps must not
    go backward.

    Raises
    ------
    ArgumentError
        A measurement has no odometry.
    """
    scans, readings = tee(measurements)
    before = after = _told(next(readings))
    for _, scan in scans:
        at = scan.stamp_ns + round(skew_s * 1e9)
        while after.stamp_ns < at:
            before, coming = after, next(readings, None)
            if coming is None:
                return
            after = _told(coming)
        if at >= before.stamp_ns:
            yield Measurement(_between(before, after, at), replace(scan, stamp_ns=at))


def _told(measurement: Measurement) -> Odometry:
    if measurement.odometry is None:
        raise ArgumentError("measurements", "odometry with every scan", f"none at {measurement.scan.stamp_ns} ns")
    return measurement.odometry


def _between(before: Odometry, after: Odometry, stamp_ns: int) -> Odometry:
    """Odometry at a time between two readings, as if the twist were constant."""
    share = (stamp_ns - before.stamp_ns) / max(after.stamp_ns - before.stamp_ns, 1)
    twist = se2.log(se2.between(before.pose, after.pose))
    return Odometry.at(stamp_ns, se2.compose(before.pose, se2.exp(share * twist)))


def _distorted(
    measurements: Iterable[Measurement], change: Callable[[FloatArray, float], FloatArray]
) -> Iterator[Measurement]:
    """Odometry rebuilt from increments whose twist (3,) and duration in s went through `change`.

    Scans without odometry pass as they are.
    """
    last: Odometry | None = None
    pose = np.zeros(3)
    for odometry, scan in measurements:
        if odometry is None:
            yield Measurement(None, scan)
            continue
        if last is None:
            pose = odometry.pose
        else:
            twist = se2.log(se2.between(last.pose, odometry.pose))
            pose = se2.compose(pose, se2.exp(change(twist, (odometry.stamp_ns - last.stamp_ns) * 1e-9)))
        last = odometry
        yield Measurement(Odometry.at(odometry.stamp_ns, pose), scan)
