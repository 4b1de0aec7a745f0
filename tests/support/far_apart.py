"""Real logs whose scans are far apart: public ones of key scans only, and others thinned so."""

from __future__ import annotations

import gzip
import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

import gridslam
from gridslam.evaluation import absolute_errors
from gridslam.geometry.angles import wrap
from gridslam.io.measurement import Measurement

SPARSE = {"acapulco": 0.39, "belgioioso": 0.325, "seattle": 0.13, "freiburg-101": 0.065}
"""Logs of key scans, and how far (m, rms) any seed may be from GMapping's path; ecac047: 14.6, 0.35, 1.8, 0.05 m."""

THINNED = {("aces", 10): 0.195, ("mit-csail", 2): 0.195, ("mit-csail", 5): 0.195}
"""Logs of which one in so many scans is taken, and how far off (m, rms); ecac047: 18.2, 0.06 to 2.5, 15 m."""


def off_from(poses: np.ndarray, reference: np.ndarray) -> float:
    """Root mean square of the position's error (m) of poses (N, 3) against a reference (N, 3), best aligned."""
    stamps = np.arange(len(reference)) * 10**9
    trajectories = gridslam.Trajectory(stamps, poses), gridslam.Trajectory(stamps, reference)
    return absolute_errors(*trajectories).trans_rmse_m


def gmapping_path(data: Path, name: str) -> np.ndarray:
    """What GMapping made of a sparse log, (N, 3); good to about 5 cm."""
    with gzip.open(data / "sparse" / f"{name}.ref.tum.gz", "rt") as file:
        rows = np.loadtxt(file)
    return np.column_stack([rows[:, 1:3], 2 * np.arctan2(rows[:, 6], rows[:, 7])])


def every_half_metre(log: Iterable[Measurement]) -> Iterator[tuple[int, Measurement]]:
    """A scan every 0.5 m or 0.5 rad of odometry, and its number in the log."""
    last = None
    for number, measurement in enumerate(log):
        pose = measurement.odometry.pose
        far = last is None or math.hypot(*(pose - last)[:2]) >= 0.5 or abs(wrap(pose[2] - last[2])) >= 0.5
        if far:
            last = pose
            yield number, measurement
