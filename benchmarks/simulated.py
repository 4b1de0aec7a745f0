"""Map a simulated drive with what a benchmark needs of it: every report, and the full result."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from gridslam.config import Configuration, build
from gridslam.io.measurement import Measurement
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import FullSlam, full_slam
from gridslam.types import StepReport


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
