"""Loop closure where the truth is known: worlds made to deceive, a campus of 2 km."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from closure_errors import false_closures
from closure_worlds import DECEPTIVE, Drive, campus, deceptive
from gridslam.config import Configuration, build
from gridslam.geometry.se2 import between
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import full_slam
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.types import FloatArray
from report import Report, Target, table

__all__ = ["ClosureRun", "closures", "judge_closures"]

_HEAD = [
    "drive",
    "CPU s",
    "recognized",
    "false of them",
    "refinement constraints",
    "false of them",
    "filter m",
    "refined m",
]


class ClosureRun(NamedTuple):
    """What was closed on a drive, and the mean errors over relations of the filter and of the final trajectory."""

    cpu_s: float
    recognized: int
    recognized_false: int
    tied: int
    tied_false: int
    filter_m: float
    refined_m: float


def closures(report: Report, seeds: Sequence[int], config: Configuration) -> None:
    """Drive every world with each seed; the error is the mean over relations, as in Kuemmerle et al. (2009).

    A relation is four key scans long, or leads back to a place seen before.
    """
    for title, drives in (
        ("Worlds made to deceive", [deceptive(kind, seed) for kind in DECEPTIVE for seed in seeds]),
        ("Campus, 2 km", [campus(seed) for seed in seeds]),
    ):
        runs = [judge_closures(drive, config) for drive in drives]
        report.add(title, table(_HEAD, [[drive.name, *run] for drive, run in zip(drives, runs, strict=True)]))
        report.targets.append(Target(f"{title}: recognized falsely", sum(run.recognized_false for run in runs), 0))
        if title.startswith("Campus"):
            worst = max(run.refined_m for run in runs)
            report.targets.append(Target(f"{title}: mean error of the worst seed", worst, 0.05, unit="m"))


def judge_closures(drive: Drive, config: Configuration) -> ClosureRun:
    """Map a drive, and compare what was closed with the truth."""
    recorder, began = TrajectoryRecorder(), time.process_time()
    stream, slam = drive.stream(), build(config)
    state = run(stream.measurements, slam, rng=np.random.default_rng(0), observers=[recorder])
    said = full_slam(state, [recorder.tracked_scans()], config.mapper, config.loop_closure)
    cpu_s, truth = time.process_time() - began, np.asarray(stream.truth.poses)
    keys = np.flatnonzero(np.diff(recorder.keys, prepend=-1))
    assert state.closure_state is not None
    constraints = [
        constraint
        for constraint in state.closure_state.graph.constraints
        if constraint.source is ConstraintSource.RECOGNIZED
    ]
    ends = np.array([(constraint.from_, constraint.to) for constraint in constraints], np.int64).reshape(-1, 2)
    found = false_closures(
        truth[keys], ends, np.array([constraint.measurement for constraint in constraints]).reshape(-1, 3)
    )
    joint = np.arange(len(said.graph.edges)) >= len(keys) - 1
    graph = said.graph
    tied = false_closures(truth[keys], graph.edges[joint], graph.measurements[joint], graph.information[joint])
    filtered = _relation_error(truth[keys], state.ancestry.trajectory(state.best))
    refined = _relation_error(truth[keys], said.poses[keys])
    return ClosureRun(cpu_s, len(constraints), int(found.sum()), int(joint.sum()), int(tied.sum()), filtered, refined)


def _relation_error(truth: FloatArray, poses: FloatArray) -> float:
    """Mean error in m of relations over four key scans, and back to the nearest place of at least 40 before."""
    pairs = [(k, k + 4) for k in range(0, len(truth) - 4, 2)]
    for k in range(60, len(truth), 2):
        away = np.hypot(*(truth[: k - 40, :2] - truth[k, :2]).T)
        if away.min() < 1.5:
            pairs.append((int(away.argmin()), k))
    i, j = np.array(pairs).T
    missed = between(between(truth[i], truth[j]), between(poses[i], poses[j]))
    return float(np.hypot(missed[:, 0], missed[:, 1]).mean())
