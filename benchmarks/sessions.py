"""Sessions: logs that are continued, found again and merged; and pieces that must stay apart.

    python benchmarks/sessions.py                  everything; about an hour and a half on one core
    python benchmarks/sessions.py --part halves    one of the parts below
    python benchmarks/sessions.py --part halves --log intel --seeds 0-9

Writes benchmarks/results/sessions.json, each part by itself; the others stay as they are.
"""

from __future__ import annotations

import argparse
import bz2
import filecmp
import itertools
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gridslam
from gridslam.evaluation.trajectory import relation_errors
from gridslam.geometry.se2 import between, compose
from gridslam.io.log import open_log
from gridslam.io.measurement import Measurement
from gridslam.io.selection import Log
from gridslam.io.trajectories import read_relations
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.sim.floor_plan import clearance, furniture, join
from gridslam.sim.world import World
from gridslam.types import FloatArray, Trajectory
from measure import GRIDSLAM, RESULTS, timed, write_document

_ELSEWHERE = np.array([10.0, 0.0, 2.0])
"""Another day: the odometry begins 10 m off, turned by 2 rad."""
_CUTS = {"intel": (0.5, 15.0), "aces": (0.6, 30.0), "mit-csail": (0.5, 30.0)}
"""Where a log is cut, so that its second part soon revisits the first one; and within how many metres it
it shall be found."""
_ROBOTS = ((0.0, 0.45), (0.3, 0.8), (0.6, 1.0))
"""Parts of the Intel log that three robots drive; where they overlap one has the odd scans, another the even ones."""


_DATA = Path(os.environ.get("GRIDSLAM_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


def _as_log(folder: Path, name: str, measurements: Sequence[Measurement]) -> Log:
    from gridslam.io.carmen.writer import write_carmen

    path = folder / f"{name}.clf"
    write_carmen(path, measurements)
    return open_log(path)


def _move(measurements: Sequence[Measurement], frame: FloatArray = _ELSEWHERE) -> list[Measurement]:
    """The same measurements with an odometry that begins at `frame` (3,)."""
    begin = measurements[0].odometry
    assert begin is not None
    return [
        Measurement(
            None if odometry is None else replace(odometry, pose=compose(frame, between(begin.pose, odometry.pose))),
            scan,
        )
        for odometry, scan in measurements
    ]


def _worsen(measurements: Sequence[Measurement], rng: np.random.Generator) -> list[Measurement]:
    """The same measurements with more noise of the odometry: 3 % of the way and of the turns, as by another robot."""
    scale = 1 + rng.normal(0, 0.03, 2)
    pose = np.zeros(3)
    last = measurements[0].odometry
    assert last is not None
    worse = []
    for odometry, scan in measurements:
        assert odometry is not None
        step = between(last.pose, odometry.pose)
        size = float(np.hypot(step[0], step[1]))
        step = step * [scale[0], scale[0], scale[1]] + rng.normal(0, 1, 3) * [0.02 * size, 0.02 * size, 0.01 * size]
        pose = compose(pose, step)
        last = odometry
        worse.append(Measurement(replace(odometry, pose=pose), scan))
    return worse


def _mean_distance_m(trajectory: Trajectory, reference: Trajectory) -> float:
    """Mean distance of the poses of a trajectory from those of the same stamps in another."""
    known = dict(zip(reference.stamps_ns.tolist(), reference.poses[:, :2], strict=True))
    there = np.array([known[stamp] for stamp in trajectory.stamps_ns.tolist()])
    return float(np.hypot(*(trajectory.poses[:, :2] - there).T).mean())


def _relations_m(name: str, trajectory: Trajectory) -> float | None:
    path = _DATA / f"{name}.relations"
    return relation_errors(trajectory, read_relations(path)).trans_mean_m if path.exists() else None


def halves(folder: Path, seeds: Sequence[int], names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """The second part of a log as another day, found in the map of the first one; against one run of the whole."""
    for name, seed in itertools.product(names, seeds):
        measurements = list(open_log(_DATA / f"{name}.clf.bz2"))
        cut, limit_m = _CUTS[name]
        first = int(cut * len(measurements))
        one = gridslam.map_log(_as_log(folder, "one", measurements), seed=seed)
        session = gridslam.Session(seed=seed)
        session.add(_as_log(folder, "first", measurements[:first]), repair="none")
        result = session.add(_as_log(folder, "second", _move(measurements[first:])), repair="none")
        found = result.found_again
        yield {
            "log": name,
            "seed": seed,
            "cut": cut,
            "found_after_m": None if found is None else round(found.way_m, 1),
            "limit_m": limit_m,
            "mean_distance_m": None if found is None else _mean_distance_m(result.trajectory, one.trajectory),
            "relations_m": _relations_m(name, result.trajectory),
            "relations_of_one_run_m": _relations_m(name, one.trajectory),
        }


def robots(folder: Path, seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """The Intel log as driven by three robots, merged in one order and in the reverse."""
    measurements = list(open_log(_DATA / "intel.clf.bz2"))
    for seed in seeds:
        rng = np.random.default_rng(seed)
        owner = _share(len(measurements))
        files = []
        for robot in range(len(_ROBOTS)):
            own = _move(
                _worsen([m for m, k in zip(measurements, owner, strict=True) if k == robot], rng), rng.uniform(-3, 3, 3)
            )
            session = gridslam.Session(seed=seed)
            session.add(_as_log(folder, f"robot{robot}", own), repair="none")
            files.append(folder / f"robot{robot}.gridslam")
            session.save(files[-1])
        answers = []
        begin = time.perf_counter()
        for order in (files, files[::-1]):
            sessions = [gridslam.Session.open(file) for file in order]
            full = sessions[0].merge(*sessions[1:])
            answers.append((full.poses.tobytes(), full.map.log_odds.tobytes()))
            if len(answers) == 1:
                seconds = time.perf_counter() - begin
        merged = sessions[0]
        stamps = np.concatenate([drive.stamps_ns for drive in merged.pieces[0].drives])
        order_by_stamp = np.argsort(stamps, kind="stable")
        yield {
            "seed": seed,
            "pieces": len(merged.pieces),
            "relations_m": _relations_m("intel", Trajectory(stamps[order_by_stamp], full.poses[order_by_stamp])),
            "orders_alike": len(set(answers)) == 1,
            "seconds": round(seconds, 1),
        }


def _share(count: int) -> list[int]:
    """The robot that has each scan: one of those whose parts it is in, in turn."""
    owners = []
    for scan in range(count):
        candidates = [
            k
            for k, (first, last) in enumerate(_ROBOTS)
            if first <= scan / count < last or (last == 1.0 <= (scan + 1) / count)
        ]
        owners.append(candidates[scan % len(candidates)])
    return owners


def _drive(world: World, seed: int, frame: FloatArray | None = None) -> tuple[list[Measurement], Trajectory]:
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(), np.random.default_rng(1000 + seed))
    return _move(log.measurements, np.zeros(3) if frame is None else frame), log.truth


def pairs(folder: Path, seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Two days in one simulated building, the second one from elsewhere: against the truth."""
    for seed in seeds:
        world = make_world("random", np.random.default_rng(seed))
        begin = len(world.route) // 3
        first, truth = _drive(world, seed)
        second, later = _drive(replace(world, route=world.route[begin:]), 500 + seed, _ELSEWHERE)
        session = gridslam.Session(seed=seed)
        session.add(_as_log(folder, "first", first), repair="none")
        result = session.add(_as_log(folder, "second", second), place="elsewhere", repair="none")
        found = result.found_again
        expected = between(truth.poses[0], later.poses)
        first_day = result.trajectories["first"].poses - between(truth.poses[0], truth.poses)
        own = result.trajectories["second"].poses
        yield {
            "seed": seed,
            "found_after_m": None if found is None else round(found.way_m, 1),
            "mean_error_m": None if found is None else float(np.hypot(*(own - expected)[:, :2].T).mean()),
            "first_day_error_m": float(np.hypot(*first_day[:, :2].T).mean()),
        }


def apart(folder: Path, seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Other buildings, and other floors that look alike: nothing may be joined, neither online nor by merging."""
    for kind, seed in itertools.product(("random", "equal_rooms"), seeds):
        first, _ = _drive(make_world(kind, np.random.default_rng(2 * seed)), seed)
        second, _ = _drive(make_world(kind, np.random.default_rng(2 * seed + 1)), 500 + seed, _ELSEWHERE)
        yield {"world": kind, "seed": seed} | _join(folder, first, second)


def changed(folder: Path, seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """The same floor of equal rooms on another day, with a desk more in one room."""
    for seed in seeds:
        rng = np.random.default_rng(seed)
        world = make_world("equal_rooms", rng)
        first, _ = _drive(world, seed)
        low, high = world.walls.reshape(-1, 2).min(axis=0), world.walls.reshape(-1, 2).max(axis=0)
        while True:
            x, y = rng.uniform(low, high).tolist()
            desk = furniture(x, y, 1.2, 0.6)
            near = clearance(desk, world.route).min()
            if (
                0.6 < near < 2.5
                and clearance(
                    desk,
                    np.concatenate([world.route[:-1] * (1 - s) + world.route[1:] * s for s in np.linspace(0, 1, 40)]),
                ).min()
                > 0.5
            ):
                break
        second, _ = _drive(replace(world, walls=join(world.walls, desk)), 500 + seed, _ELSEWHERE)
        yield {"seed": seed} | _join(folder, first, second)


def _join(folder: Path, first: Sequence[Measurement], second: Sequence[Measurement]) -> dict[str, Any]:
    """Whether a second day is found again online, and, if not, whether merging joins it."""
    session = gridslam.Session()
    session.add(_as_log(folder, "first", first), repair="none")
    result = session.add(_as_log(folder, "second", second), place="elsewhere", repair="none")
    found = result.found_again
    if found is None:
        session.merge()
    return {"found_after_m": None if found is None else round(found.way_m, 1), "joined": len(session.pieces) == 1}


def real_pair(folder: Path, seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Two drives of a robot in one building, wean1 and wean2."""
    for seed in seeds:
        session = gridslam.Session(seed=seed)
        for name in ("wean1", "wean2"):
            result = session.add(_DATA / "loops" / f"{name}.clf.gz", place="auto" if name == "wean1" else "elsewhere")
        found = result.found_again
        if found is None:
            session.merge()
        yield {
            "seed": seed,
            "found_after_m": None if found is None else round(found.way_m, 1),
            "joined": len(session.pieces) == 1,
        }


def cuts(folder: Path, parts: Sequence[int]) -> Iterator[dict[str, Any]]:
    """The Intel log cut into so many parts, each continued by the command; whether its files are those of one run."""
    whole = _DATA / "intel.clf.bz2"
    one = folder / "one"
    timed([*GRIDSLAM, "map", whole, "-o", one, "--repair", "none"])
    with bz2.open(whole, "rt", encoding="utf-8") as file:
        lines = file.readlines()
    for count in parts:
        saved = folder / f"{count}.gridslam"
        out = folder / f"cut-{count}"
        for part in range(count):
            log = folder / f"intel-{count}-{part}.clf"
            log.write_text(
                "".join(lines[part * len(lines) // count : (part + 1) * len(lines) // count]), encoding="utf-8"
            )
            options = ["--continue", saved] if part else []
            timed([*GRIDSLAM, "map", log, "-o", out, "--repair", "none", "--save", saved, *options])
        names = ("trajectory.tum", "map.pgm", "graph.g2o")
        yield {"parts": count, "identical": {name: filecmp.cmp(one / name, out / name, False) for name in names}}


def file(folder: Path, seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Size of the session of the Intel log, and the seconds that it takes to write and to read."""
    path = folder / "intel.gridslam"
    for seed in seeds:
        session = gridslam.Session(seed=seed)
        session.add(open_log(_DATA / "intel.clf.bz2"), repair="none")
        begin = time.perf_counter()
        session.save(path)
        written = time.perf_counter()
        gridslam.Session.open(path)
        read_s = time.perf_counter() - written
        yield {
            "seed": seed,
            "mb": round(path.stat().st_size / 1e6, 1),
            "write_s": round(written - begin, 2),
            "read_s": round(read_s, 2),
        }


_PARTS: dict[str, tuple[Callable[..., Iterator[dict[str, Any]]], Sequence[int]]] = {
    "halves": (halves, range(10)),
    "robots": (robots, range(1)),
    "pairs": (pairs, range(5)),
    "real_pair": (real_pair, range(1)),
    "apart": (apart, range(20)),
    "changed": (changed, range(20)),
    "cuts": (cuts, (2, 3, 7)),
    "file": (file, range(3)),
}


def main() -> None:
    """Run the parts, and write what each comes to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", choices=_PARTS)
    parser.add_argument("--log", choices=_CUTS)
    parser.add_argument("--seeds", help="FIRST-LAST")
    options = parser.parse_args()
    path = RESULTS / "sessions.json"
    for part in [options.part] if options.part else _PARTS:
        function, seeds = _PARTS[part]
        if options.seeds:
            first, last = map(int, options.seeds.split("-"))
            seeds = range(first, last + 1)
        more = [[options.log] if options.log else list(_CUTS)] if part == "halves" else []
        with tempfile.TemporaryDirectory() as folder:
            for row in function(Path(folder), seeds, *more):
                print(part, row, flush=True)
                known = json.loads(path.read_text(encoding="utf-8"))["parts"] if path.exists() else {}
                rows = known.get(part, [])
                same = [
                    own
                    for own in rows
                    if all(own.get(key) == row.get(key) for key in ("log", "world", "seed", "parts"))
                ]
                known[part] = [own for own in rows if own not in same] + [row]
                write_document(path, "python benchmarks/sessions.py", parts=known)


if __name__ == "__main__":
    main()
