"""gridslam demo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from gridslam.cli import STARTED_S
from gridslam.cli.evaluate import format_scores, score_against_truth
from gridslam.cli.live import live_page, wait_for_viewer
from gridslam.cli.map import map_with_progress, summary
from gridslam.cli.output import open_output, print_json
from gridslam.cli.rerun import rerun_recording
from gridslam.config import Configuration
from gridslam.evaluation.trajectory import align
from gridslam.geometry.se2 import compose
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.trajectories import write_tum
from gridslam.live.options import LiveOptions
from gridslam.pipeline import Stopwatch
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import Trajectory

__all__ = ["DEMO_SCHEMA", "demo"]

DEMO_SCHEMA = "gridslam.demo/1"

_SPEED = 30.0  # times as fast as the robot drives, so that one can look on
_LOG, _TRUTH = "demo.clf.gz", "truth.tum"


def demo(out: Path, seed: int, live: LiveOptions | None, rerun: str | None, as_json: bool) -> None:
    """Simulate the world `demo`, map it and compare with the truth."""
    watch, rng = Stopwatch(STARTED_S, 0.0), np.random.default_rng(seed)
    slowed, configuration = None if live is None else replace(live, speed=_SPEED), Configuration()
    range_max_m = configuration.range_max_m
    with rerun_recording(rerun, "demo", range_max_m) as recording, live_page(slowed, "demo", range_max_m) as page:
        with open_output(out) as folder:
            simulated = simulate(make_world("demo", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)
            write_carmen(folder.file(_LOG), simulated.measurements)
            write_tum(folder.file(_TRUTH), simulated.truth)
            watch.lap("simulate")
            wait_for_viewer(page)
            watch.resume()
            log = CarmenLog(folder.file(_LOG))
            result = map_with_progress(log, configuration, seed, 1, not as_json, watch, page=page, recording=recording)
            result = replace(result, source=out / _LOG)
            document = result.write(folder, truth=_align_truth(simulated.truth, result.trajectory))
        errors, odometry = (score_against_truth(t, simulated.truth) for t in (result.trajectory, simulated.odometry))
        if as_json:
            print_json({"schema": DEMO_SCHEMA, "run": document, "errors": errors, "odometry_errors": odometry})
            return
        lines = [
            *summary(document, result, out),
            "against the truth:",
            *(f"  {line}" for line in format_scores(errors)),
        ]
        click.echo("\n".join([*lines, "the odometry alone:", *(f"  {line}" for line in format_scores(odometry))]))


def _align_truth(truth: Trajectory, estimate: Trajectory) -> Trajectory:
    """Align the true trajectory rigidly with the estimate; both have the same scans."""
    return Trajectory(truth.stamps_ns, compose(align(truth.poses[:, :2], estimate.poses[:, :2]), truth.poses))
