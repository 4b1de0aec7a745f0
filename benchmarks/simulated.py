"""Drives of benchmarks: key scans of one, and its map with every report and the full result."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gridslam.config import Configuration, build
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import FullSlam, full_slam
from gridslam.types import FloatArray, StepReport


def thin(poses: FloatArray, metres: float, radians: float) -> list[int]:
    """Return the places of poses (N, 3) each of which is so far, or turned so much, from the one before."""
    kept = [0]
    for k in range(len(poses)):
        dx, dy, turn = between(poses[kept[-1]], poses[k])
        if np.hypot(dx, dy) >= metres or abs(turn) >= radians:
            kept.append(k)
    return kept


def map_drive(
    measurements: Iterable[Measurement], configuration: Configuration, seed: int
) -> tuple[list[StepReport], FullSlam]:
    """Map a drive with loop closure; the report of each scan, and the final result."""
    assert configuration.loop_closure is not None
    recorder = TrajectoryRecorder()
    reports: list[StepReport] = []
    state = run(
        measurements,
        build(configuration),
        rng=np.random.default_rng(seed),
        observers=[recorder, lambda report, state, seconds: reports.append(report)],
    )
    full = full_slam(state, [recorder.tracked_scans()], configuration.mapper, configuration.loop_closure)
    return reports, full
