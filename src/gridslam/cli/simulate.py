"""gridslam simulate and gridslam demo: a robot in a world that is made up."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path

import click
import numpy as np

from gridslam.api.evaluation import score_against_truth
from gridslam.api.mapping import MapResult, map_log
from gridslam.cli import find_start_s
from gridslam.cli.evaluate import format_scores
from gridslam.cli.live import open_viewers
from gridslam.cli.map import map_with_progress, summarize
from gridslam.cli.options import name_option
from gridslam.cli.output import open_output, print_result
from gridslam.config import Configuration
from gridslam.evaluation.trajectory import align
from gridslam.geometry.se2 import compose
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.trajectories import write_tum
from gridslam.live.options import LiveOptions
from gridslam.pipeline import Stopwatch
from gridslam.sim import (
    LidarConfig,
    OdometryNoise,
    PeopleConfig,
    RobotConfig,
    make_world,
    simulate,
    vary_route,
)
from gridslam.types import Trajectory

DEMO_SCHEMA = "gridslam.demo/1"
SIMULATION_SCHEMA = "gridslam.simulation/1"

_DEMO_LOG = "demo.clf.gz"
_DEMO_SPEED = 30.0
"""Speed of the page, a factor on real time, at which one can follow."""
_DEMO_WAIT_S = 60.0
_DAY_S = 86_400.0
_CARMEN = (".clf", ".log", ".carmen")
_PACKED = (".gz", ".bz2")


def simulate_to_log(
    world: str,
    out: Path,
    seed: int,
    world_seed: int | None,
    beams: int,
    fov_deg: float,
    range_max_m: float,
    rate_hz: float,
    people: int,
    duration_s: float | None,
    as_json: bool,
) -> None:
    """Write a simulated log and its true trajectory."""
    truth_path = out.with_name(_truth_name(out))
    lidar = LidarConfig(beams=beams, field_of_view_rad=math.radians(fov_deg), range_max_m=range_max_m, rate_hz=rate_hz)
    scans = None if duration_s is None else math.floor(min(duration_s, _DAY_S) * rate_hz) + 1
    rng = np.random.default_rng(seed)
    crowd = PeopleConfig(count=people)
    with open_output(out.parent) as folder:
        with name_option(name="WORLD"):
            if world_seed is None:
                driven = make_world(world, rng)
            else:
                driven = vary_route(make_world(world, np.random.default_rng(world_seed)), rng)
            log = simulate(driven, RobotConfig(), OdometryNoise(), lidar, rng, people=crowd)
        truth = Trajectory(log.truth.stamps_ns[:scans], log.truth.poses[:scans])
        write_carmen(folder.file(out.name), islice(log.measurements, scans))
        write_tum(folder.file(truth_path.name), truth)
    steps = np.diff(truth.poses[:, :2], axis=0)
    length_m = float(np.hypot(steps[:, 0], steps[:, 1]).sum())
    duration_s = float(np.ptp(truth.stamps_ns)) * 1e-9
    document = {
        "schema": SIMULATION_SCHEMA,
        "world": world,
        "seed": seed,
        "world_seed": seed if world_seed is None else world_seed,
        "log": str(out),
        "truth": str(truth_path),
        "scans": len(truth),
        "walls": len(log.walls),
        "duration_s": duration_s,
        "length_m": length_m,
    }
    summary = [
        f"{world}: {len(truth)} scans, {duration_s:.0f} s, {length_m:.0f} m driven",
        f"log: {out}",
        f"truth: {truth_path}",
    ]
    print_result(document, summary, as_json)


def _truth_name(out: Path) -> str:
    """The truth of run.1.clf.gz is run.1.truth.tum."""
    plain = out.with_suffix("") if out.suffix in _PACKED else out
    if plain.suffix not in _CARMEN:
        raise click.ClickException(
            f"{out}: expected a name that ends in .clf, .log or .carmen, also with .gz or .bz2 "
            "(gridslam convert writes other formats)"
        )
    return f"{plain.stem}.truth.tum"


def demo(out: Path, seed: int, live: LiveOptions | None, no_history: bool, as_json: bool) -> None:
    """Simulate the world `demo`, map it and compare with the truth."""
    watch = Stopwatch(find_start_s(), 0.0)
    rng = np.random.default_rng(seed)
    configuration = Configuration()
    slowed = None if live is None else replace(live, speed=live.speed or _DEMO_SPEED)
    with open_viewers(slowed, "demo", configuration.range_max_m, out=out, has_history=not no_history) as viewers:
        with open_output(out, MapResult.all_names()) as folder:
            simulated = simulate(make_world("demo", rng), RobotConfig(), OdometryNoise(), LidarConfig(), rng)
            write_carmen(folder.file(_DEMO_LOG), simulated.measurements)
            write_tum(folder.file("truth.tum"), simulated.truth)
            watch.lap("simulate")
            viewers.wait(_DEMO_WAIT_S)
            watch.resume()
            log = CarmenLog(folder.file(_DEMO_LOG))
            result = map_with_progress(
                log, partial(map_log, configuration=configuration, seed=seed), watch, viewers, shown=not as_json
            )
            moved = align(simulated.truth.poses[:, :2], result.trajectory.poses[:, :2])  # of the same scans
            truth = Trajectory(simulated.truth.stamps_ns, compose(moved, simulated.truth.poses))
            viewers.write_history(folder)
            document = replace(result, source=out / _DEMO_LOG, truth=truth).write(folder)
        errors = score_against_truth(result.trajectory, simulated.truth)
        odometry = score_against_truth(simulated.odometry, simulated.truth)
        summary = [
            *summarize(document, result, out),
            "against the truth:",
            *(f"  {line}" for line in format_scores(errors)),
            "the odometry alone:",
            *(f"  {line}" for line in format_scores(odometry)),
        ]
        content = {"schema": DEMO_SCHEMA, "run": document, "errors": errors, "odometry_errors": odometry}
        print_result(content, summary, as_json)
