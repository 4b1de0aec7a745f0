"""Accuracy over seeds, and what it cost: every log is mapped by the whole command, once for each seed."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from gridslam.evaluation import RelationErrors, absolute_errors, relation_errors
from gridslam.io.trajectories import read_relations
from logs import Log
from measure import GRIDSLAM, MapRun, map_timed, timed
from report import Report, Target, table


class _Limits(NamedTuple):
    """Targets of one log with relations, each with the best peer's figure and GMapping's."""

    mean_m: tuple[float, str, str]
    worst_seed_m: float
    rotation_deg: tuple[float, str]


_LIMITS = {
    "intel": _Limits((0.020, "0.0198", "0.037"), 0.025, (0.30, "0.27")),
    "aces": _Limits((0.0415, "0.0415", "0.050"), 0.05, (0.40, "0.36")),
}
_ROTATION_OF_GMAPPING = "1.3 to 1.9"
_COST_HEAD = ["seed", "CPU s", "yardsticks", "peak MB", "scan ms (median)", "p99", "longest", "x real time"]


def accuracy(logs: Sequence[Log], seeds: Sequence[int], report: Report, pictures: Path) -> None:
    """Map every log with each seed; where nothing true is known of a log, its pictures are kept to be looked at."""
    for log in logs:
        known = log.relations is not None or log.truth is not None
        runs = [
            map_timed(log.path, "--seed", seed, picture=None if known else pictures / f"{log.name}-{seed}.png")
            for seed in seeds
        ]
        missing = max(run.document["scans"]["read"] - len(run.trajectory) for run in runs)
        report.targets.append(Target(f"{log.name}: scans without a pose", missing, 0))
        head, scores = _scores(log, runs, report)
        rows = [[*_cost_row(seed, run), *score] for seed, run, score in zip(seeds, runs, scores, strict=True)]
        numbers = list(zip(*(row[1:] for row in rows), strict=True))
        means = ["mean", *(statistics.fmean(column) for column in numbers)]
        greatest = ["greatest", *(max(column) for column in numbers)]
        title = f"{log.name}: seeds {seeds[0]} to {seeds[-1]}"
        report.add(title, table([*_COST_HEAD, *head], [*rows, means, greatest]))
        if log.name == "intel":
            _cost_targets(runs, report)


def starts(log: Log, report: Report, repeats: int) -> None:
    """How long one waits: for the help, and for the first scan of a log; wall time, the median of a few."""
    first_scan = (
        "import os, sys, gridslam.cli.main, gridslam.cli.map; from gridslam import map_log; "
        "map_log(sys.argv[1], observers=[lambda report, state, seconds: os._exit(0)])"
    )
    commands: dict[str, tuple[list[str | Path], float]] = {
        "gridslam --help": ([*GRIDSLAM, "--help"], 0.3),
        f"first scan of {log.name} processed": ([GRIDSLAM[0], "-c", first_scan, log.path], 1.0),
    }
    rows = []
    for name, (command, limit) in commands.items():
        seconds = [timed(command).wall_s for _ in range(repeats)]
        median = statistics.median(seconds)
        report.targets.append(Target(name, median, limit, unit="s"))
        rows.append([name, median, min(seconds), max(seconds)])
    report.add("Start", table(["", "median s", "least s", "greatest s"], rows))


def _cost_row(seed: int, run: MapRun) -> list[float]:
    real_time = run.document["input"]["duration_s"] / run.cost.wall_s
    return [seed, run.cost.cpu_s, run.cost.yardsticks, run.peak_mb, *run.latency_ms.values(), real_time]


def _scores(log: Log, runs: Sequence[MapRun], report: Report) -> tuple[list[str], list[list[float]]]:
    """What was true of each run, as columns of the table."""
    if log.relations is not None:
        relations = read_relations(log.relations)
        errors = [relation_errors(run.trajectory, relations) for run in runs]
        _relation_targets(log.name, errors, report)
        head = ["relations m", "worst m", "rotation deg", "exact"]
        return head, [[e.trans_mean_m, e.trans_max_m, e.rot_mean_deg, e.exact] for e in errors]
    if log.truth is not None:
        absolute = [absolute_errors(run.trajectory, log.truth) for run in runs]
        return ["ATE rmse m", "ATE max m", "rotation deg"], [
            [e.trans_rmse_m, e.trans_max_m, e.rot_rmse_deg] for e in absolute
        ]
    return ["poses", "lost"], [[len(run.trajectory), run.document["scans"]["lost"]] for run in runs]


def _relation_targets(name: str, errors: Sequence[RelationErrors], report: Report) -> None:
    means = [error.trans_mean_m for error in errors]
    worst = max(error.trans_max_m for error in errors)
    report.targets += [
        Target(f"{name}: worst single relation", worst, 0.5, "0.33 to 0.40", "0.28 to 0.92", "m"),
        Target(f"{name}: share of relations without a pose of their own", 1 - min(e.exact for e in errors), 0.0),
    ]
    if limits := _LIMITS.get(name):
        rotation = statistics.fmean(error.rot_mean_deg for error in errors)
        report.targets += [
            Target(f"{name}: mean relation error", statistics.fmean(means), *limits.mean_m, "m"),
            Target(f"{name}: ... of the worst seed", max(means), limits.worst_seed_m, unit="m"),
            Target(f"{name}: rotation, mean", rotation, *limits.rotation_deg, _ROTATION_OF_GMAPPING, "deg"),
        ]


def _cost_targets(runs: Sequence[MapRun], report: Report) -> None:
    yardsticks = statistics.fmean(run.cost.yardsticks for run in runs)
    latency = max(run.latency_ms["p99"] for run in runs)
    peak = max(run.peak_mb for run in runs)
    report.targets += [
        Target("intel: CPU of the whole command (goal 16)", yardsticks, 32.0, "16", "270 to 630", "yardsticks"),
        Target("intel: peak memory", peak, 160.0, "31", "156", "MB"),
        Target("intel: p99 latency of a scan", latency, 25.0, "4.5", "94 to 436", "ms"),
    ]
