"""Drive the filter and tell what each key scan cost, in CPU time of this thread, to which other work adds none."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable

import numpy as np

import gridslam
from gridslam.io.measurement import Measurement


def drive(
    measurements: Iterable[Measurement],
    rng: np.random.Generator,
    look: Callable[[gridslam.GridFastSlamState], None] = lambda state: None,
) -> tuple[gridslam.GridFastSlamState, np.ndarray, np.ndarray]:
    """Final state, poses told online (N, 3), CPU seconds of the key scans; `look` sees the state after each scan."""
    slam, state, poses, seconds = gridslam.GridFastSlam(), None, [], []
    for odometry, scan in measurements:
        began = time.thread_time()
        state, report = slam.step(state, odometry, scan, rng) if state else slam.init(odometry, scan, 30)
        if report.skipped is None:
            seconds.append(time.thread_time() - began)
        poses.append(report.pose)
        look(state)
    return state, np.array(poses), np.array(seconds)
