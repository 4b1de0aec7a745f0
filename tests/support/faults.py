"""Single named faults of a log, each of a given size: what `gridslam doctor` must find, and a map must survive.

A fault is a function from a stream of measurements to the same with the fault in it, in constant memory; what is random
about it is drawn from the generator it is given. `FAULTS` has them all by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from itertools import chain, tee
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from gridslam.geometry import se2
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, FloatArray, LaserScan, Odometry, ScanGeometry
from support import se3

_CEILING_M = 2.5
_SIGMA_RANGE_M = 0.01
_WRONG_SHARE = 0.02


def odometry_scale(measurements: Iterable[Measurement], excess: float) -> Iterator[Measurement]:
    """Odometry reports 1 + `excess` m per metre; turns are unchanged. 0.03: wheels 3 % smaller than declared."""
    return _distorted(measurements, lambda twist, _: twist * [1 + excess, 1 + excess, 1.0])


def odometry_rotation_bias(measurements: Iterable[Measurement], excess: float) -> Iterator[Measurement]:
    """Odometry reports 1 + `excess` rad per radian turned: wheels closer together than declared."""
    return _distorted(measurements, lambda twist, _: twist * [1.0, 1.0, 1 + excess])


def odometry_drift(measurements: Iterable[Measurement], bias_rad_per_m: float) -> Iterator[Measurement]:
    """Odometry adds a left turn of `bias_rad_per_m` per metre driven to the true turn: unequal wheels."""
    return _distorted(measurements, lambda twist, _: np.add(twist, [0, 0, bias_rad_per_m * np.hypot(*twist[:2])]))


def unsigned_odometry(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    """Odometry counts reverse motion as forward, as encoders without direction do; turns are unchanged."""
    return _distorted(measurements, lambda twist, _: np.array([abs(twist[0]), twist[1], twist[2]]))


def clock_skew(measurements: Iterable[Measurement], skew_s: float) -> Iterator[Measurement]:
    """Scans are stamped `skew_s` s after the time at which they were taken, as read on the odometry's clock.

    A scan comes with the odometry of its wrong stamp, interpolated between readings along an arc. Where it would lie
    beyond all readings the scan is left out, at the end for skew_s > 0 and at the begin for skew_s < 0. Stamps must not
    go backward, and each measurement has odometry.
    """
    scans, readings = tee(measurements)
    before = after = _require_odometry(next(readings))
    for _, scan in scans:
        at = scan.stamp_ns + round(skew_s * 1e9)
        while after.stamp_ns < at:
            before = after
            coming = next(readings, None)
            if coming is None:
                return
            after = _require_odometry(coming)
        if at >= before.stamp_ns:
            yield Measurement(_between(before, after, at), replace(scan, stamp_ns=at))


def _require_odometry(measurement: Measurement) -> Odometry:
    assert measurement.odometry is not None
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


def reflected_laser(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    """Ranges come in reverse order, each with its own time, and the log does not know.

    Models a laser that turns clockwise or is mounted upside-down without being declared as such.
    """

    def reflect(scan: LaserScan) -> LaserScan:
        times = None if scan.beam_times_s is None else scan.beam_times_s[::-1].copy()
        return replace(scan, ranges=scan.ranges[::-1].copy(), status=scan.status[::-1].copy(), beam_times_s=times)

    return _with_scans(measurements, reflect)


def yaw_offset(measurements: Iterable[Measurement], yaw_rad: float) -> Iterator[Measurement]:
    """The laser is mounted `yaw_rad` rad farther to the left than declared; pi: it looks backward."""

    @cache
    def turned(geometry: ScanGeometry) -> ScanGeometry:
        return ScanGeometry(geometry.bearings, geometry.base_from_laser @ se3.from_planar([0.0, 0.0, -yaw_rad]))

    return _with_scans(measurements, lambda scan: replace(scan, geometry=turned(scan.geometry)))


def beam_count_varies(
    measurements: Iterable[Measurement], fewer: float, rng: np.random.Generator
) -> Iterator[Measurement]:
    """Of each scan the last 0 to `fewer` beams are missing, another number each time: 460 beams with 6 are 454 to 460.

    Angles and times of the others are right. At least one beam is left; `fewer` is a whole number.
    """

    @cache
    def cut(geometry: ScanGeometry, count: int) -> ScanGeometry:
        return ScanGeometry(geometry.bearings[:count], geometry.base_from_laser)

    def shorten(scan: LaserScan) -> LaserScan:
        count = max(1, len(scan) - int(rng.integers(0, int(fewer) + 1)))
        return replace(
            scan,
            ranges=scan.ranges[:count],
            status=scan.status[:count],
            geometry=cut(scan.geometry, count),
            beam_times_s=None if scan.beam_times_s is None else scan.beam_times_s[:count],
        )

    return _with_scans(measurements, shorten)


def invalid_beams(measurements: Iterable[Measurement], share: float, rng: np.random.Generator) -> Iterator[Measurement]:
    """Each beam is NaN with probability `share`, in [0, 1]."""
    return _with_scans(
        measurements, lambda scan: _measured(scan, np.where(rng.random(len(scan)) < share, np.nan, scan.ranges))
    )


def range_limits(measurements: Iterable[Measurement], factor: float) -> Iterator[Measurement]:
    """Scans declare `factor` times their true maximum range.

    Above 1 a beam without return, reported as the true greatest range, reads as a wall there; below 1 walls beyond the
    declared range read as no return.
    """
    return _with_scans(measurements, lambda scan: _measured(scan, scan.ranges, range_max_m=factor * scan.range_max_m))


def tilted_laser(measurements: Iterable[Measurement], tilt_rad: float, height_m: float = 0.3) -> Iterator[Measurement]:
    """The laser is tilted by `tilt_rad` rad, nose down, but declared level.

    From `height_m` m above the floor it sees the floor where that is nearer than the walls, or with its nose up the
    ceiling, 2.5 m high. Walls are as high as the room, and known from the level scan, between whose beams the inverse
    range is interpolated.
    """
    return _with_scans(measurements, lambda scan: _measured(scan, _tilted_ranges(scan, tilt_rad, height_m)))


def tilting_laser(
    measurements: Iterable[Measurement], amplitude_rad: float, period_s: float = 4.0, height_m: float = 0.3
) -> Iterator[Measurement]:
    """The laser nods by `amplitude_rad` rad up and down, and each scan has its true mounting: no 2D log.

    What it sees is as of `tilted_laser`.
    """

    def nod(scan: LaserScan) -> LaserScan:
        tilt = amplitude_rad * math.sin(math.tau * scan.stamp_ns * 1e-9 / period_s)
        pitched = np.eye(4)
        pitched[:3:2, :3:2] = [[math.cos(tilt), math.sin(tilt)], [-math.sin(tilt), math.cos(tilt)]]
        geometry = ScanGeometry(scan.geometry.bearings, scan.geometry.base_from_laser @ pitched)
        return _measured(scan, _tilted_ranges(scan, tilt, height_m), geometry=geometry)

    return _with_scans(measurements, nod)


def gaps(
    measurements: Iterable[Measurement], gap_s: float, rng: np.random.Generator, every_s: float = 30.0
) -> Iterator[Measurement]:
    """Nothing was recorded for `gap_s` s, at a random moment in each `every_s` seconds of the log; gap_s < every_s."""
    begin_ns: int | None = None
    part = -1
    gap = 0.0
    for measurement in measurements:
        begin_ns = measurement.scan.stamp_ns if begin_ns is None else begin_ns
        seconds = (measurement.scan.stamp_ns - begin_ns) * 1e-9
        while seconds >= (part + 1) * every_s:
            part += 1
            gap = rng.uniform(0, every_s - gap_s)
        if not 0 < seconds - part * every_s - gap <= gap_s:
            yield measurement


def backward_stamps(
    measurements: Iterable[Measurement], back_s: float, rng: np.random.Generator
) -> Iterator[Measurement]:
    """Two in a hundred measurements are stamped `back_s` s before the one that comes before them in the log."""
    return _restamped(measurements, back_s, _WRONG_SHARE, rng)


def duplicate_stamps(
    measurements: Iterable[Measurement], share: float, rng: np.random.Generator
) -> Iterator[Measurement]:
    """A `share`, in [0, 1], of the measurements has the stamp of the one before."""
    return _restamped(measurements, 0.0, share, rng)


def _restamped(
    measurements: Iterable[Measurement], back_s: float, share: float, rng: np.random.Generator
) -> Iterator[Measurement]:
    last_ns: int | None = None
    for measurement in measurements:
        wrong = last_ns is not None and rng.random() < share
        restamped = _at(measurement, last_ns - round(back_s * 1e9)) if wrong and last_ns is not None else measurement
        last_ns = restamped.scan.stamp_ns
        yield restamped


def standing_still(
    measurements: Iterable[Measurement], still_s: float, rng: np.random.Generator
) -> Iterator[Measurement]:
    """Before it drives the robot stands for `still_s` s, and goes on measuring at the rate of the first two scans.

    The ranges then differ by a noise of 1 cm; all later stamps are `still_s` later, up to a scan's period.
    """
    coming = iter(measurements)
    first = next(coming)
    second = next(coming)
    period_ns = second.scan.stamp_ns - first.scan.stamp_ns
    count = round(still_s * 1e9 / period_ns)
    hits = first.scan.status == BeamStatus.HIT
    for k in range(count):
        noise = np.where(hits, _SIGMA_RANGE_M * rng.standard_normal(len(hits)), 0.0)
        seen = replace(first.scan, ranges=np.maximum(first.scan.ranges + noise, 1e-3))
        yield _at(Measurement(first.odometry, seen), first.scan.stamp_ns + k * period_ns)
    for measurement in chain([first, second], coming):
        yield _at(measurement, measurement.scan.stamp_ns + count * period_ns)


def _at(measurement: Measurement, stamp_ns: int) -> Measurement:
    odometry = measurement.odometry
    reported = None if odometry is None else replace(odometry, stamp_ns=stamp_ns)
    return Measurement(reported, replace(measurement.scan, stamp_ns=stamp_ns))


def _with_scans(measurements: Iterable[Measurement], change: Callable[[LaserScan], LaserScan]) -> Iterator[Measurement]:
    for odometry, scan in measurements:
        yield Measurement(odometry, change(scan))


def _tilted_ranges(scan: LaserScan, tilt: float, height_m: float) -> FloatArray:
    """What the laser of a level scan sees after a rotation about its y axis, from the rays' horizontal bearings."""
    bearings = scan.geometry.bearings
    forward = np.cos(bearings) * math.cos(tilt)
    aside = np.sin(bearings)
    down = np.cos(bearings) * math.sin(tilt)
    order = np.argsort(bearings)
    level = 1 / np.interp(np.arctan2(aside, forward), bearings[order], 1 / scan.ranges[order])
    flat = np.where(down > 0, height_m, height_m - _CEILING_M) / np.where(down == 0, 1e-9, down)
    return np.minimum(np.minimum(level / np.hypot(forward, aside), np.abs(flat)), scan.range_max_m)


def _measured(
    scan: LaserScan, ranges: FloatArray, geometry: ScanGeometry | None = None, range_max_m: float | None = None
) -> LaserScan:
    """Build the same scan from other ranges, and from other angles and limits where they are given."""
    return LaserScan.from_ranges(
        scan.stamp_ns,
        ranges,
        geometry or scan.geometry,
        range_min_m=scan.range_min_m,
        range_max_m=scan.range_max_m if range_max_m is None else range_max_m,
        sensor=scan.sensor,
        frame=scan.frame,
        beam_times_s=scan.beam_times_s,
    )


class Fault(NamedTuple):
    """A fault by name: (measurements, size, rng) to measurements; its default size, and its unit."""

    apply: Callable[[Iterable[Measurement], float, np.random.Generator], Iterator[Measurement]]
    size: float
    unit: str


def _certain(fault: Callable[[Iterable[Measurement], float], Iterator[Measurement]], size: float, unit: str) -> Fault:
    """Make a fault in which nothing is random."""
    return Fault(lambda measurements, size, _: fault(measurements, size), size, unit)


FAULTS: Final[Mapping[str, Fault]] = MappingProxyType(
    {
        "reflected_laser": Fault(lambda measurements, *_: reflected_laser(measurements), 1.0, "yes or no"),
        "yaw_offset": _certain(yaw_offset, math.pi, "rad"),
        "clock_skew": _certain(clock_skew, 0.03, "s"),
        "odometry_scale": _certain(odometry_scale, 0.03, "m/m"),
        "odometry_rotation_bias": _certain(odometry_rotation_bias, 0.05, "rad/rad"),
        "odometry_drift": _certain(odometry_drift, 0.02, "rad/m"),
        "unsigned_odometry": Fault(lambda measurements, *_: unsigned_odometry(measurements), 1.0, "yes or no"),
        "beam_count_varies": Fault(beam_count_varies, 6.0, "beams"),
        "invalid_beams": Fault(invalid_beams, 0.2, "share"),
        "range_limits": _certain(range_limits, 2.0, "m/m"),
        "tilted_laser": _certain(tilted_laser, 0.1, "rad"),
        "tilting_laser": _certain(tilting_laser, 0.3, "rad"),
        "gaps": Fault(gaps, 2.0, "s"),
        "backward_stamps": Fault(backward_stamps, 0.05, "s"),
        "duplicate_stamps": Fault(duplicate_stamps, 0.02, "share"),
        "standing_still": Fault(standing_still, 60.0, "s"),
    }
)
"""The faults; those that `gridslam doctor` detects have the codes of its findings as names."""


def with_fault(
    measurements: Iterable[Measurement], name: str, rng: np.random.Generator, size: float | None = None
) -> Iterator[Measurement]:
    """Give a stream the fault of that name, of a size or of the usual one."""
    fault = FAULTS[name]
    return fault.apply(measurements, fault.size if size is None else size, rng)
