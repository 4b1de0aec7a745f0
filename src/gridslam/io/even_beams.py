"""Scans in formats that hold the first value and the step of their beams, and limits between which all hits lie."""

from __future__ import annotations

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.types import BeamStatus, FloatArray, LaserScan


def find_step(name: str, values: FloatArray, tolerance: float) -> tuple[float, float]:
    """Return first value and step of values (B,) that are evenly spread; raises ArgumentError for others."""
    if len(values) < 2:
        return float(values.sum()), 0.0
    step = float(values[-1] - values[0]) / (len(values) - 1)
    if not (np.abs(values - values[0] - step * np.arange(len(values))) <= tolerance).all():
        raise ArgumentError(name, "evenly spread beams, as the format holds the first and the step", values)
    return float(values[0]), step


def find_time_increment(times_s: FloatArray, tolerance_s: float) -> float:
    """Return the time between two beams, s, where the first is at the scan's stamp; raises ArgumentError elsewhere."""
    first, step = find_step("beam_times_s", times_s, tolerance_s)
    if abs(first) > tolerance_s:
        raise ArgumentError("beam_times_s", "times that grow from 0 at the first beam", times_s)
    return step


def require_hits_within_limits(scan: LaserScan) -> None:
    """Check that all hits lie within the range limits; raises ArgumentError for others."""
    hits = scan.ranges[scan.status == BeamStatus.HIT]
    if not ((hits > 0) & (hits >= scan.range_min_m) & (hits < scan.range_max_m)).all():
        limits = f"hits from {scan.range_min_m:g} m on and below {scan.range_max_m:g} m"
        raise ArgumentError("ranges", limits, (float(hits.min()), float(hits.max())))
