"""Ranges in wrong units, frozen lasers and random ranges, and healthy logs of all kinds.

Each log is checked as it is, with its ranges in other units (and their limit converted, or left in metres), every tenth
scan alone, without odometry, with its laser frozen, and with random ranges.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from gridslam.doctor import EarlyCheck, Finding
from gridslam.doctor.range_units import UNITS
from gridslam.io.log import open_log
from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus, LaserScan

CODES = ("range_units", "laser_frozen", "random_ranges")
_LOGS = (
    "*.clf.bz2",
    "sparse/*.clf.gz",
    "loops/*.clf.gz",
    "bags/*.bag",
    "bags/turtlebot4_floor",
)


def _converted(log: Iterable[Measurement], factor: float, *, limit: bool) -> Iterator[Measurement]:
    """Ranges times a factor; with their limit, or with that left in metres."""
    for odometry, scan in log:
        largest = scan.range_max_m * (factor if limit else 1.0)
        yield Measurement(odometry, _read(scan, np.round(scan.ranges * factor, 3), largest))


def _read(scan: LaserScan, ranges: np.ndarray, range_max_m: float) -> LaserScan:
    return LaserScan.from_ranges(
        scan.stamp_ns,
        ranges,
        scan.geometry,
        range_min_m=scan.range_min_m,
        range_max_m=range_max_m,
        sensor=scan.sensor,
        frame=scan.frame,
        beam_times_s=scan.beam_times_s,
    )


def _frozen(log: Iterable[Measurement]) -> Iterator[Measurement]:
    first: dict[str, LaserScan] = {}
    for odometry, scan in log:
        yield Measurement(odometry, replace(first.setdefault(scan.sensor, scan), stamp_ns=scan.stamp_ns))


def _stuck(log: Iterable[Measurement]) -> Iterator[Measurement]:
    """A frozen view that goes on flickering: 5 mm of noise."""
    rng = np.random.default_rng(0)
    for odometry, scan in _frozen(log):
        noise = np.where(scan.status == BeamStatus.HIT, 0.005 * rng.standard_normal(len(scan)), 0.0)
        yield Measurement(odometry, replace(scan, ranges=np.maximum(scan.ranges + noise, 1e-3)))


def _random(log: Iterable[Measurement], low: float = 0.2, high: float = 10.0) -> Iterator[Measurement]:
    rng = np.random.default_rng(0)
    for odometry, scan in log:
        yield Measurement(odometry, _read(scan, rng.uniform(low, high, len(scan)), math.inf))


def _sparse(log: Iterable[Measurement]) -> Iterator[Measurement]:
    return islice(log, 0, None, 10)


def _bare(log: Iterable[Measurement]) -> Iterator[Measurement]:
    return (Measurement(None, m.scan) for m in log)


Change = Callable[[Iterable[Measurement]], Iterable[Measurement]]


def _unit(factor: float, *, limit: bool = True) -> Change:
    return lambda log: _converted(log, factor, limit=limit)


VARIANTS: Mapping[str, tuple[str, Change]] = {
    "healthy": ("", iter),
    "healthy, every tenth scan": ("", _sparse),
    "healthy, without odometry": ("", _bare),
    **{f"in {unit}": ("range_units", _unit(factor)) for unit, factor in UNITS.items()},
    "in millimetres, limit in m": ("range_units", _unit(1000.0, limit=False)),
    "in feet, limit in m": ("range_units", _unit(UNITS["feet"], limit=False)),
    "in feet, every tenth scan": ("range_units", lambda log: _sparse(_unit(UNITS["feet"])(log))),
    "in millimetres, every tenth scan": ("range_units", lambda log: _sparse(_unit(1000.0)(log))),
    "in centimetres, without odometry": ("range_units", lambda log: _bare(_unit(100.0)(log))),
    "in millimetres, without odometry": ("range_units", lambda log: _bare(_unit(1000.0)(log))),
    "frozen": ("laser_frozen", _frozen),
    "frozen, with noise": ("laser_frozen", _stuck),
    "random": ("random_ranges", _random),
    "random, without odometry": ("random_ranges", lambda log: _bare(_random(log))),
}
"""By name: the finding that is due, and what is done to a healthy log."""


def found_early(log: Iterable[Measurement]) -> list[Finding]:
    """Check the beginning of a log as `gridslam map` does."""
    early = EarlyCheck()
    findings: list[Finding] = []
    for measurement in log:
        findings += early.take(measurement)
        if early.is_complete:
            break
    return [*findings, *early.end()]


def check(log: Iterable[Measurement]) -> tuple[str, ...]:
    """Name the early findings of `CODES`, units by their number in a metre."""
    return tuple(
        f"{f.code} {f.size:.4g}" if f.code == "range_units" and f.size is not None else f.code
        for f in found_early(log)
        if f.code in CODES
    )


def real_logs(folder: Path) -> Iterator[tuple[str, Iterator[Measurement]]]:
    """Name and measurements of the healthy logs of a folder, up to 3000 scans each."""
    for pattern in _LOGS:
        for path in sorted(folder.glob(pattern)):
            yield path.name, islice(open_log(path), 3000)
