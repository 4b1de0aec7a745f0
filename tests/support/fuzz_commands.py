"""Cases of the whole command line: coordinates, ranges and parameters that no robot has, and steps that fail.

A case holds a log and the arguments of one command. It passes where the command ends with status 0, or is refused with
status 2 and one line.
"""

from __future__ import annotations

import importlib
import json
import os
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.cli.main import main
from gridslam.errors import InputError
from gridslam.io.csv import write_csv_log
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import BeamStatus, FloatArray, Odometry
from support.parameter_extremes import cases

__all__ = ["FaultyStep", "Prepare", "Read", "commands", "run_command"]

_FAST = ("--particles", "2", "--set", "loop_closure=false")
_PARTS = (
    "gridslam.models.motion:DiffusionMotion.__call__",
    "gridslam.models.endpoint:CauchyEndPoint.__call__",
    "gridslam.mapping.occupancy_grid_mapping:OccupancyGridMapping.__call__",
    "gridslam.particles.policies:MotionThreshold.__call__",
    "gridslam.particles.policies:EffectiveSampleSizeBelow.__call__",
    "gridslam.particles.ancestry:Ancestry.extend",
    "gridslam.slam.grid_fastslam.proposals:ScanMatchedProposal.__call__",
)

Prepare = Callable[[Path, np.random.Generator], None]
Read = Callable[[Path], object]


def commands() -> Iterator[tuple[str, int, Prepare, Read, float]]:
    """Name, point of the report of hostile input, the two functions and the weight of each family."""
    drive = _simulate("rooms", 300)
    short = drive[:60]
    yield "far poses", 1, partial(_write_far_poses, short), _run, 1.0
    yield "steps that fail", 3, partial(_write_fault, short), _run_faulty, 1.0
    yield "implausible ranges", 7, partial(_write_ranges, drive), _run_named, 0.5
    yield "far beams", 11, partial(_write_far_beams, short[:20]), _run, 0.3
    yield "parameters", 12, partial(_write_parameter, short, cases()), _run, 1.0


def _simulate(world: str, scans: int) -> list[Measurement]:
    rng = np.random.default_rng(0)
    lidar = LidarConfig(beams=90)
    return list(simulate(make_world(world, rng), RobotConfig(), OdometryNoise(), lidar, rng).measurements[:scans])


def _write(to: Path, measurements: list[Measurement], *arguments: str) -> None:
    """Write a case: its log and what follows it on the command line."""
    write_csv_log(to / "log.csv", measurements)
    (to / "arguments.json").write_text(json.dumps(arguments))


def _run(where: Path) -> str:
    """Run a case's command over its log, and return what it has printed as warnings."""
    command, *arguments = json.loads((where / "arguments.json").read_text())
    arguments = [argument.replace("HERE", str(where)) for argument in arguments]
    text = _run_main(where, [command, str(where / "log.csv"), "-o", str(where / "out"), "--json", *arguments])
    assert (where / "out" / "map.yaml").exists()
    return text


def run_command(where: Path) -> None:
    """Run the command whose arguments a case holds; one that is refused must leave nothing behind."""
    before = {*where.iterdir()}
    try:
        _run_main(where, json.loads((where / "arguments.json").read_text()))
    except InputError:
        left = {*where.iterdir()} - before - {where / "stderr.txt"}
        assert not left, f"left behind: {sorted(path.name for path in left)}"
        raise


def _run_main(where: Path, arguments: list[str]) -> str:
    """Run the command line, and return what it has printed as warnings; raises InputError where it refuses."""
    with (
        open(where / "stderr.txt", "w") as errors,
        open(os.devnull, "w") as nothing,
        redirect_stderr(errors),
        redirect_stdout(nothing),
    ):
        os.dup2(errors.fileno(), 2)  # what is not written by way of sys.stderr
        status = main(arguments)
    text = (where / "stderr.txt").read_text().strip()
    lines = text.splitlines() or [""]
    assert status in (0, 2), f"status {status}: {lines[-1]}"
    assert "Traceback" not in text, lines[-1]
    if status == 2:
        assert len(lines) == 1, f"{len(lines)} lines: {text[:200]}"
        assert text.startswith("gridslam: "), text
        raise InputError(where, text)
    return text


def _write_far_poses(drive: list[Measurement], to: Path, rng: np.random.Generator) -> None:
    """The whole drive, or a part of it, is moved by up to 10^13 m; its poses are known, or its odometry."""
    offset = np.zeros(3)
    offset[:2] = rng.choice([-1.0, 1.0], 2) * 10.0 ** rng.uniform(3, 13, 2)
    first = int(rng.choice([0, len(drive) // 2]))
    last = int(rng.choice([len(drive), first + 1]))
    moved = [
        Measurement(Odometry(scan.stamp_ns, odometry.pose + offset * (first <= k < last)), scan)
        for k, (odometry, scan) in enumerate(drive)
        if odometry is not None
    ]
    if rng.integers(2):
        preset = str(rng.choice(["default", "gmapping"]))
        _write(to, moved, "map", *_FAST, "--preset", preset)
        return
    rows = (
        f"{odometry.stamp_ns / 1e9:.6f} {x:.6f} {y:.6f} 0 0 0 {np.sin(theta / 2):.9f} {np.cos(theta / 2):.9f}\n"
        for odometry, _ in moved
        if odometry is not None
        for x, y, theta in [odometry.pose.tolist()]
    )
    (to / "far.tum").write_text("".join(rows))
    _write(to, drive, "grid", "--trajectory", "HERE/far.tum")


class FaultyStep:
    """A method that raises when it is called for the `call`-th time, and once only."""

    def __init__(self, method: Callable[..., Any], call: int) -> None:
        self._method = method
        self._left = call

    def __get__(self, instance: object, owner: type) -> Callable[..., Any]:
        """Bind to an object, as a function does."""
        return partial(self, instance)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """Call the method, or raise."""
        self._left -= 1
        if self._left == 0:
            raise RuntimeError("injected")
        return self._method(*arguments, **options)


def _write_fault(drive: list[Measurement], to: Path, rng: np.random.Generator) -> None:
    _write(to, drive, "map", *_FAST)
    (to / "fault.json").write_text(json.dumps([str(rng.choice(_PARTS)), int(rng.integers(2, 8))]))


def _run_faulty(where: Path) -> None:
    """All but the scan whose step fails must be mapped."""
    place, call = json.loads((where / "fault.json").read_text())
    module, _, names = place.partition(":")
    owner, method = names.split(".")
    part = getattr(importlib.import_module(module), owner)
    setattr(part, method, FaultyStep(getattr(part, method), call))
    _run(where)
    scans = len((where / "log.csv").read_text().splitlines()) - 1
    mapped = len((where / "out" / "trajectory.tum").read_text().splitlines())
    assert mapped >= scans - 1, f"{mapped} of {scans} scans"


def _write_ranges(drive: list[Measurement], to: Path, rng: np.random.Generator) -> None:
    """Ranges in millimetres, of a laser that is frozen or random, or healthy ones."""
    kind = rng.choice(["healthy", "millimetres", "frozen", "random"])
    ranges = np.stack([scan.ranges for _, scan in drive])
    if kind == "millimetres":
        ranges = ranges * 1000 * rng.uniform(0.98, 1.02)
    elif kind == "frozen":
        ranges = np.broadcast_to(ranges[rng.integers(len(drive))], ranges.shape)
    elif kind == "random":
        ranges = rng.uniform(0.1, rng.uniform(5, 30), ranges.shape)
    _write(to, _with_ranges(drive, ranges), "map", *_FAST)
    (to / "kind.txt").write_text(str(kind))


def _run_named(where: Path) -> None:
    """Whatever is wrong with the ranges must be named, or refused; healthy ones must not be."""
    kind = (where / "kind.txt").read_text()
    warnings = _run(where)
    assert bool(warnings) == (kind != "healthy"), f"{kind}: {warnings or 'no warning'}"


def _write_far_beams(drive: list[Measurement], to: Path, rng: np.random.Generator) -> None:
    """A hall of up to a kilometre, or single beams that long."""
    ranges = np.stack([scan.ranges for _, scan in drive])
    is_far = rng.random(ranges.shape) < rng.choice([0.01, 0.1, 1.0])
    far_m = rng.uniform(100, 1000) * rng.uniform(0.9, 1.0, ranges.shape)
    _write(to, _with_ranges(drive, np.where(is_far, far_m, ranges)), "map", *_FAST, "--set", "range_max_m=1000")


def _with_ranges(drive: list[Measurement], ranges: FloatArray) -> list[Measurement]:
    """The drive with other ranges (N, B), all of them hits."""
    return [
        Measurement(
            odometry, replace(scan, ranges=row, status=np.full_like(scan.status, BeamStatus.HIT), range_max_m=np.inf)
        )
        for (odometry, scan), row in zip(drive, ranges, strict=True)
    ]


def _write_parameter(drive: list[Measurement], extremes: Any, to: Path, rng: np.random.Generator) -> None:
    """One number of the configuration at an extreme."""
    number, value = extremes[rng.integers(len(extremes))]
    kinds = [assignment for part, kind in number.kinds for assignment in ("--set", f"{part}.kind={kind}")]
    _write(to, drive, "map", "--particles", "2", *kinds, "--set", f"{number.name}={value!r}")
