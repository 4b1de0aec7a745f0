"""Landmark SLAM: what a step costs, and accuracy on real logs.

python benchmarks/landmarks.py [--data ../shared/data] [--seeds 10]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gridslam.api.landmarks import METHODS, PARTICLES, LandmarkMethod, LandmarkResult, map_landmarks
from gridslam.evaluation.maps import pair_by_name
from gridslam.evaluation.trajectory import align
from gridslam.geometry.se2 import transform_points
from gridslam.models.association import KnownCorrespondence
from gridslam.models.landmark import LandmarkObservations, RangeBearing
from gridslam.models.motion import DiffusionMotion
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.slam.landmarks.fastslam1 import FastSlam1
from gridslam.slam.landmarks.fastslam2 import FastSlam2
from gridslam.slam.landmarks.filters import LandmarkFilters
from gridslam.types import FloatArray
from report import Report, table

_SENSOR, _MOTION = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02), DiffusionMotion()
_INCREMENT = np.array([0.05, 0.0, 0.01])
_SEEN = 2  # landmarks seen at a step
_PARTS = 3


def landmarks(report: Report, data: Path, seeds: Sequence[int], steps: int = 100) -> None:
    """Cost on a field of landmarks, then accuracy on MRCLAM where the data is there."""
    rates = []
    for kind in (FastSlam1, FastSlam2):
        slam = kind(LandmarkFilters(_SENSOR, KnownCorrespondence()))
        rates.append([kind.__name__, _fastslam_rate(slam, 1000, 100, steps)])
    report.add("FastSLAM, 1000 particles of 100 landmarks", table(["filter", "steps/s"], rates))
    ekf = [[count, _ekf_ms(count, steps)] for count in (15, 100, 500)]
    report.add(f"EKF SLAM, {_SEEN} observations a step", table(["landmarks", "ms/step"], ekf))
    for robot in (1, 3):
        log = data / "landmarks" / f"mrclam6_Robot{robot}_Odometry.dat.gz"
        if log.exists():
            _mrclam(report, log, robot, seeds)
    if (park := data / "landmarks" / "victoria_park.txt.gz").exists():
        _victoria_park(report, park, seeds)


def _field(count: int) -> FloatArray:
    """Landmarks (count, 2) in a square around the robot, none of them near it."""
    angle = np.arange(count) * 2.399963  # the golden angle: evenly spread
    return (5.0 + 0.2 * np.arange(count))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _observe(
    field: FloatArray, pose: FloatArray, seen: Sequence[int], rng: np.random.Generator
) -> LandmarkObservations:
    exact = _SENSOR.linearize(pose, field[list(seen)])[0]
    return LandmarkObservations.of(exact + rng.normal(0, [0.1, 0.02], exact.shape), seen)


def _fastslam_rate(slam: FastSlam1 | FastSlam2, particles: int, count: int, steps: int) -> float:
    """Steps a second, resampling included where it is due, with all landmarks in the map."""
    rng, field, pose = np.random.default_rng(0), _field(count), np.zeros(3)
    state = slam.init(particles)
    still = DiffusionMotion(sigma_xy_m=0, sigma_theta_rad=0)(np.zeros(3))
    for k in range(0, count, _SEEN):
        state, _ = slam.step(state, still, _observe(field, pose, range(k, k + _SEEN), rng), rng)
    rates = []
    for _ in range(_PARTS):  # the best of some, since other work on the machine can only slow it down
        seen = [_observe(field, pose, [k % count, (k + count // 2) % count], rng) for k in range(steps)]
        begin = time.perf_counter()
        for observations in seen:
            state, _ = slam.step(state, _MOTION(np.zeros(3)), observations, rng)
        rates.append(steps / (time.perf_counter() - begin))
    return max(rates)


def _ekf_ms(count: int, steps: int) -> float:
    rng, field, pose = np.random.default_rng(0), _field(count), np.zeros(3)
    slam = EkfSlam(_SENSOR)
    state, _ = slam.step(slam.init(), _MOTION(_INCREMENT * 0), _observe(field, pose, range(count), rng))
    seen = [_observe(field, pose, [k % count, (k + count // 2) % count], rng) for k in range(steps)]
    begin = time.perf_counter()
    for observations in seen:
        state, _ = slam.step(state, _MOTION(_INCREMENT * 0), observations)
    return 1e3 * (time.perf_counter() - begin) / steps


def _mrclam(report: Report, log: Path, robot: int, seeds: Sequence[int]) -> None:
    """Errors with known correspondences, and landmarks found with unknown ones."""
    name, rows = f"MRCLAM 6, robot {robot}", []
    for method in METHODS:
        runs = _runs(log, method, seeds, unknown=False)
        poses = [errors.trans_rmse_m for errors, _ in (run.errors() for run in runs) if errors is not None]
        found = [errors.rmse_m for _, errors in (run.errors() for run in runs) if errors is not None]
        cost = float(np.mean([run.stopwatch.stages["solve"][1] for run in runs]))
        means = float(np.mean(poses)), float(np.mean(found))
        rows.append([method, runs[0].particles or "", means[0], max(poses), means[1], max(found), cost])
    head = ["method", "particles", "position RMSE m", "worst", "landmark RMSE m", "worst", "CPU s"]
    report.add(f"{name}, known correspondences", table(head, rows))
    rows = []
    for method in METHODS[:3]:
        errors = [run.errors()[1] for run in _runs(log, method, seeds, unknown=True)]
        found_all = [e is not None and (e.missing, e.surplus) == (0, 0) for e in errors]
        counts = ["none" if e is None else f"{e.found}+{e.surplus}" for e in errors]
        rows.append([method, f"{sum(found_all)} of {len(counts)}", ", ".join(counts)])
    report.add(f"{name}, unknown correspondences", table(["method", "15 found, none doubled", "found + surplus"], rows))


def _runs(log: Path, method: LandmarkMethod, seeds: Sequence[int], unknown: bool = False) -> list[LandmarkResult]:
    if method not in PARTICLES:
        return [map_landmarks(log, method, unknown=unknown)]
    return [map_landmarks(log, method, seed=seed, unknown=unknown) for seed in seeds]


def _victoria_park(report: Report, log: Path, seeds: Sequence[int]) -> None:
    """How far the methods are from the graph, on average over the seeds, and the worst."""
    graph, rows = map_landmarks(log, "graph"), []
    for method in METHODS[:3]:
        apart = []
        for run in _runs(log, method, seeds):
            ours, theirs = pair_by_name(run.landmarks.names, graph.landmarks.names)
            landmarks = _median_apart(run.landmarks.positions[ours], graph.landmarks.positions[theirs])
            apart.append([landmarks, _median_apart(run.estimate.poses[:, :2], graph.estimate.poses[:, :2])])
        means, worst = np.mean(apart, axis=0).tolist(), np.max(apart, axis=0).tolist()
        rows.append([method, run.particles or "", means[0], worst[0], means[1], worst[1]])
    head = ["method", "particles", "landmarks from the graph's m", "worst", "trajectory m", "worst"]
    report.add("Victoria Park: medians", table(head, rows))


def _median_apart(points: FloatArray, others: FloatArray) -> float:
    return float(np.median(np.hypot(*(transform_points(align(points, others), points) - others).T)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--seeds", type=int, default=10, help="seeds 0, 1, ... of each method")
    given = parser.parse_args()
    landmarks(Report(), given.data, range(given.seeds))
