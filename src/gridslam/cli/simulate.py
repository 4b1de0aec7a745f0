"""gridslam simulate."""

from __future__ import annotations

import math
from itertools import islice
from pathlib import Path

import click
import numpy as np

from gridslam.cli.output import open_output, print_json
from gridslam.errors import ArgumentError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.trajectories import write_tum
from gridslam.sim import (
    LidarConfig,
    OdometryNoise,
    PeopleConfig,
    RobotConfig,
    SimulatedStream,
    make_world,
    simulate_stream,
)
from gridslam.types import Trajectory

__all__ = ["SIMULATION_SCHEMA", "simulate_to_log"]

SIMULATION_SCHEMA = "gridslam.simulation/1"

_DAY_S = 86_400.0
_CARMEN = ".clf", ".log", ".carmen"
_PACKED = ".gz", ".bz2"


def simulate_to_log(
    world: str,
    out: Path,
    seed: int,
    beams: int,
    fov_deg: float,
    range_max_m: float,
    rate_hz: float,
    people: int,
    duration_s: float | None,
    as_json: bool,
) -> None:
    """Write a simulated log and its true trajectory."""
    truth = out.with_name(_truth_name(out))
    lidar = _lidar(beams, fov_deg, range_max_m, rate_hz)
    if duration_s is not None and not duration_s >= 0:
        raise click.ClickException(f"--duration: expected 0 s or more, got {duration_s:g}")
    scans = None if duration_s is None else math.floor(min(duration_s, _DAY_S) * rate_hz) + 1
    rng = np.random.default_rng(seed)
    with open_output(out.parent) as folder:
        try:
            crowd = PeopleConfig(count=people)
            log = simulate_stream(make_world(world, rng), RobotConfig(), OdometryNoise(), lidar, rng, people=crowd)
        except ArgumentError as error:
            raise click.ClickException(str(error).replace("name:", "WORLD:", 1)) from None
        kept = _cut(log.truth, scans)
        write_carmen(folder.file(out.name), islice(log.measurements, scans))
        write_tum(folder.file(truth.name), kept)
    _print_summary(log, kept, world, seed, out, truth, as_json)


def _truth_name(out: Path) -> str:
    """The truth of run.1.clf.gz is run.1.truth.tum."""
    if out.is_dir() or not out.name:
        raise click.ClickException(f"{out}: expected the name of a file, got a folder")
    plain = out.with_suffix("") if out.suffix in _PACKED else out
    if plain.suffix not in _CARMEN:
        raise click.ClickException(
            f"{out}: expected a name that ends in .clf, .log or .carmen, also with .gz or .bz2 "
            "(gridslam convert writes other formats)"
        )
    return f"{plain.stem}.truth.tum"


def _lidar(beams: int, fov_deg: float, range_max_m: float, rate_hz: float) -> LidarConfig:
    for option, value in (("--fov", fov_deg), ("--range-max", range_max_m), ("--rate", rate_hz)):
        if not math.isfinite(value):
            raise click.ClickException(f"{option}: expected a finite number, got {value:g}")
    return LidarConfig(beams=beams, field_of_view_rad=math.radians(fov_deg), range_max_m=range_max_m, rate_hz=rate_hz)


def _cut(trajectory: Trajectory, scans: int | None) -> Trajectory:
    return Trajectory(trajectory.stamps_ns[:scans], trajectory.poses[:scans])


def _print_summary(
    log: SimulatedStream, kept: Trajectory, world: str, seed: int, out: Path, truth: Path, as_json: bool
) -> None:
    steps = np.diff(kept.poses[:, :2], axis=0)
    length_m, duration_s = float(np.hypot(*steps.T).sum()), float(np.ptp(kept.stamps_ns)) * 1e-9
    if as_json:
        print_json({
            "schema": SIMULATION_SCHEMA, "world": world, "seed": seed, "log": str(out), "truth": str(truth),
            "scans": len(kept), "walls": len(log.walls), "duration_s": duration_s, "length_m": length_m,
        })  # fmt: skip
    else:
        click.echo(f"{world}: {len(kept)} scans, {duration_s:.0f} s, {length_m:.0f} m driven")
        click.echo(f"log: {out}\ntruth: {truth}")
