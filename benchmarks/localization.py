"""Monte Carlo localization: cost, and how soon and how surely a robot is found on real logs."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from global_localization import DECEPTIVE, ORDINARY, Building, GlobalRun
from gridslam.api.localization import localize
from gridslam.evaluation.trajectory import absolute_errors
from gridslam.localization import KnownMap, MonteCarloConfiguration, MonteCarloLocalization
from gridslam.localization.kld_sampling import KldSampling
from gridslam.particles import AlwaysResample, MotionThreshold
from gridslam.sim.worlds import DRAWN_WORLDS
from gridslam.types import LaserScan, OccupancyGrid, Odometry, ScanGeometry, Trajectory
from meeting_rooms import MeetingRooms
from real_localization import Mapped, driven_way, follow, found_after_m, metres
from report import Report, Target, table

__all__ = ["localization"]

_KIDNAPPED_AFTER, _SCANS = 600, 2500


def localization(report: Report, data: Path, seeds: Sequence[int], folder: Path, updates: int = 100) -> None:
    """Cost in a simulated hall, simulated buildings, then real logs where the data is there."""
    _cost(report, updates)
    _global_runs(report, seeds)
    if (data / "bags" / "p3dx_sim_truth.bag").exists():
        _meeting(report, MeetingRooms.of(data), seeds)
    if (data / "intel.clf.bz2").exists():
        _intel(report, Mapped.of(data / "intel.clf.bz2", folder), seeds)


def _hall() -> OccupancyGrid:
    """40 m x 40 m with 600 pillars."""
    rng, cells = np.random.default_rng(0), np.full((800, 800), -4.0, np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 4.0
    for row, column in rng.integers(2, 796, (600, 2)):
        cells[row : row + 3, column : column + 3] = 4.0
    return OccupancyGrid(cells, np.ones(cells.shape, bool), 0.05, (0.0, 0.0))


def _cost(report: Report, updates: int) -> None:
    """Updates a second of so many particles, all parts of a step included, resampling at each."""
    rows = []
    for particles, beams, threads in ((500, 120, 1), (10_000, 180, 1), (10_000, 180, 2)):
        rows.append([particles, beams, threads, *_rates(particles, beams, threads, updates)])
    report.add(
        "Monte Carlo localization: updates a second",
        table(["particles", "beams", "threads", "updates/s", "updates/CPU s"], rows),
    )
    # A target is a greatest value: so the time of an update, not the rate.
    report.targets.append(
        Target("MCL, 10,000 particles x 180 beams, two cores: an update", 1 / rows[-1][3], 0.01, unit="s")
    )


def _rates(particles: int, beams: int, threads: int, updates: int) -> tuple[float, float]:
    known = KnownMap(_hall(), threads=threads)
    kld = KldSampling(particles_min=particles, particles_max=particles)
    parts = MonteCarloConfiguration(
        kld=kld, max_beams=beams, when_to_update=MotionThreshold(1e-9, 1.0), when_to_resample=AlwaysResample()
    )
    mcl, rng = MonteCarloLocalization(known, parts), np.random.default_rng(0)
    truth, bearings = np.array([20.0, 20.0, 0.0]), np.linspace(-math.pi / 2, math.pi / 2, beams)
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    state, scans = mcl.init_gaussian(truth, np.diag([0.01, 0.01, 0.01]), rng), []
    for k in range(updates):
        pose = truth + np.array([0.01 * k, 0.0, 0.0])
        ranges = known.cast_rays(np.zeros(1), pose[None], np.zeros(2), directions, 30.0)[0]
        scans.append((Odometry.at(k, pose), LaserScan.from_ranges(k, ranges, ScanGeometry(bearings), range_max_m=30.0)))
    wall, cpu = time.perf_counter(), time.process_time()
    for odometry, scan in scans:
        state, _ = mcl.step(state, odometry, scan, rng)
    return updates / (time.perf_counter() - wall), updates / (time.process_time() - cpu)


def _meeting(report: Report, rooms: MeetingRooms, seeds: Sequence[int]) -> None:
    """Tracked and found from nothing; the truth is carried into the map, which is smaller than the world."""
    truth = Trajectory(rooms.truth.stamps_ns, rooms.into_map(rooms.truth.poses))
    driven, known, rows = driven_way(rooms.measurements), KnownMap(rooms.grid), []
    for seed in seeds:
        as_is, repaired = (
            localize(rooms.bag, rooms.yaml, pose=truth.poses[0], seed=seed, repair=repair).trajectory
            for repair in ("needed", "all")
        )
        errors = (_ate(as_is, truth), _ate(repaired, truth), _ate(repaired, rooms.truth))
        reports = follow(known, rooms.measurements, seed)
        near = found_after_m(metres(reports, truth.poses), driven, 0.3)
        told = next((float(driven[k]) for k, one in enumerate(reports) if not one.lost), math.inf)
        rows.append([seed, *errors, near, told])
    head = ["seed", "ATE m", "ATE m, --repair all", "against the truth as it is", "found after m", "said so after m"]
    report.add("MCL, simulated P3DX in the meeting rooms: tracked, and from nothing", table(head, rows))
    worst = np.array(rows)[:, 1:].max(axis=0)
    for name, value, limit in (("ATE", 0, 0.05), ("ATE, --repair all", 1, 0.05), ("from nothing, said so", 4, 10)):
        report.targets.append(Target(f"MCL, meeting rooms, {name}, worst seed", float(worst[value]), limit, unit="m"))


def _ate(trajectory: Trajectory, truth: Trajectory) -> float:
    return absolute_errors(trajectory, truth, aligned=True, tolerance_ns=0).trans_rmse_m


def _global_runs(report: Report, seeds: Sequence[int]) -> None:
    """From nothing, anywhere in simulated buildings: what is said of the robot, and what is true."""
    rows, kinds = [], {"ordinary": list[GlobalRun](), "deceptive": list[GlobalRun]()}
    for kind, names in (("ordinary", ORDINARY), ("deceptive", DECEPTIVE)):
        for name in names:
            buildings = [Building.of(name, seed) for seed in (seeds if name in DRAWN_WORLDS else seeds[:1])]
            runs = [buildings[k % len(buildings)].localize_globally(seed) for k, seed in enumerate(seeds)]
            kinds[kind] += runs
            rows.append([name, *_shares(runs)])
    rows += [[f"all {kind}", *_shares(runs)] for kind, runs in kinds.items()]
    head = ["building", "runs", "said to be found", "of these wrong", "right, but said lost", "the same after 10 m"]
    report.add("MCL: robots that wake up anywhere, shares of the scans on 30 m", table(head, rows))
    doubts = [[kind, *row] for kind, runs in kinds.items() for row in _doubts(GlobalRun.joined(runs))]
    head = ["buildings", "doubt", "scans", "mean doubt", "share wrong"]
    report.add("MCL: the doubt that is told, and how often the pose was wrong", table(head, doubts))


def _shares(runs: Sequence[GlobalRun]) -> list[object]:
    both = GlobalRun.joined(list(runs))
    late = GlobalRun(*(column[both.driven_m > 10] for column in both))
    return [len(runs), float((~both.lost).mean()), both.false, both.missed, late.missed]


def _doubts(told: GlobalRun) -> Iterator[list[object]]:
    for low, high in pairwise((0.0, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 1.01)):
        here = (told.doubt >= low) & (told.doubt < high)
        if here.any():
            means = (float(column[here].mean()) for column in (told.doubt, told.wrong))
            yield [f"{low:g} to {min(high, 1):g}", int(here.sum()), *means]


def _intel(report: Report, intel: Mapped, seeds: Sequence[int]) -> None:
    middle, rows = len(intel.poses) // 2, []
    part = slice(middle, middle + _SCANS)
    for seed in seeds:
        reports = follow(intel.known, intel.measurements[part], seed)
        errors, driven = metres(reports, intel.poses[part]), driven_way(intel.measurements[part])
        found = found_after_m(errors, driven, 0.5)
        mean = float(errors[driven - driven[0] > found].mean()) if found < math.inf else math.inf
        rows.append([seed, found, mean, *_kidnapping(intel, middle, seed)])
    head = ["seed", "found after m", "mean error m", "kidnapped: back after m", "said found, but was not: m"]
    report.add("MCL, Intel's second half in the map of all of it", table(head, rows))
    worst, back = max(row[2] for row in rows), sorted(row[3] for row in rows)
    report.targets.append(Target("MCL, Intel, from nothing, mean error, worst seed", worst, 0.1, unit="m"))
    report.targets.append(
        Target("MCL, Intel, kidnapped, back, 9th of 10 seeds", back[math.ceil(0.9 * len(back)) - 1], 15, unit="m")
    )


def _kidnapping(intel: Mapped, middle: int, seed: int) -> tuple[float, float]:
    """Way until the robot is found again, and the way on which it was said to be found where it was not."""
    rng = np.random.default_rng(seed)
    first, second = middle + int(rng.integers(1500)), middle + 3000 + int(rng.integers(2000))
    measurements, poses = intel.kidnapped(slice(first, first + _KIDNAPPED_AFTER), slice(second, second + 1500))
    reports = follow(intel.known, measurements, seed, poses[0])
    errors, driven = metres(reports, poses)[_KIDNAPPED_AFTER:], driven_way(measurements)[_KIDNAPPED_AFTER:]
    false = [not one.lost and error > 1 for one, error in zip(reports[_KIDNAPPED_AFTER:], errors, strict=True)]
    return found_after_m(errors, driven, 0.5), float(np.diff(driven, prepend=driven[0])[false].sum())
