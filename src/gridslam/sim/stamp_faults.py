"""Faults of time: gaps, stamps that repeat or go backward, and a robot that stands still."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from gridslam.io.measurement import Measurement
from gridslam.types import BeamStatus

__all__ = ["backward_stamps", "duplicate_stamps", "gaps", "standing_still"]

_SIGMA_RANGE_M = 0.01
_WRONG_SHARE = 0.02


def gaps(
    measurements: Iterable[Measurement], gap_s: float, rng: np.random.Generator, every_s: float = 30.0
) -> Iterator[Measurement]:
    """Nothing was recorded for `gap_s` s, at a random moment in each `every_s` seconds of the log; gap_s < every_s."""
    part, begin_ns, gap = 0, None, 0.0
    for measurement in measurements:
        stamp_ns = measurement.scan.stamp_ns
        if begin_ns is None:
            begin_ns, gap = stamp_ns, rng.uniform(0, every_s - gap_s)
        seconds = (stamp_ns - begin_ns) * 1e-9
        while seconds >= (part + 1) * every_s:
            part, gap = part + 1, rng.uniform(0, every_s - gap_s)
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
    first, second = next(coming), next(coming)
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
    told = None if odometry is None else replace(odometry, stamp_ns=stamp_ns)
    return Measurement(told, replace(measurement.scan, stamp_ns=stamp_ns))
