"""Where do the centimetres go? Errors of each stage against exact truth, beside what the beams' noise allows.

    python benchmarks/error_budget.py [WORLD ...] [--seeds 2] [--out FILE]

Stages: the odometry; the tracker that matches to cells alone; the tracker; the best particle, matched to its map at key
scans; the online trajectory (the same, smoothed); the final trajectory. "bound" is that of a scan in a known map: no
pose is better than its beams (Censi, On achievable accuracy for range-finder localization, 2007), and two of them a
metre apart err by the root of two of it. Of a simulated drive with range noise of 1 cm, in metres and degrees: over the
whole way, aligned (ATE), and over one metre of it (RPE), root mean squares.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from pathlib import Path
from unittest.mock import patch

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from gridslam.config import Configuration, build
from gridslam.evaluation import absolute_errors, relative_errors_by_distance
from gridslam.geometry.se2 import between
from gridslam.grid.scan_batch import ScanBatch
from gridslam.io.measurement import Measurement
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.surfaces import Surfaces
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam.grid_fastslam.smoothed_pose import SmoothedPose
from gridslam.tracking.tracker import Tracker
from gridslam.types import FloatArray, Trajectory
from measure import write_document
from simulated import map_drive

WORLDS = ("demo", "rooms", "loop", "hall", "random")
NOISE_M = 0.01
LEAST_COSINE = 0.1
"""Of the incidence: beams along a wall hit it anywhere."""


def track(measurements: Iterable[Measurement], tracker: Tracker) -> FloatArray:
    """Poses (N, 3) that a tracker alone gives."""
    state = None
    poses = []
    for odometry, scan in measurements:
        beams = scan.beams(0.05, 30.0)
        if state is None:
            state = tracker.init(odometry, scan.stamp_ns, beams, OccupancyGridMapping())
        else:
            tracker.step(state, odometry, scan.stamp_ns, beams)
        poses.append(state.pose)
    return np.array(poses)


def online(measurements: Iterable[Measurement]) -> FloatArray:
    """Poses (N, 3) that are reported."""
    poses = []
    observers = [lambda report, state, seconds: poses.append(report.pose)]
    run(measurements, build(Configuration()), rng=np.random.default_rng(0), observers=observers)
    return np.array(poses)


def bound(measurements: Iterable[Measurement]) -> tuple[float, float]:
    """Root mean squares (m, degrees) of the errors that the noise of the ranges allows a scan in a known map."""
    squares = []
    for _, scan in measurements:
        surfaces = Surfaces.of(ScanBatch.of([scan.beams(0.05, 30.0)]))
        ways = surfaces.points - surfaces.origins[0]
        normals = surfaces.normals
        cosine = -(normals * ways).sum(axis=1) / np.hypot(*ways.T)
        x, y = surfaces.points.T
        slopes = np.column_stack([normals, normals[:, 1] * x - normals[:, 0] * y])
        slopes /= NOISE_M * np.maximum(cosine, LEAST_COSINE)[:, None]
        covariance = np.linalg.inv(slopes.T @ slopes + 1e-6 * np.eye(3))
        squares.append((covariance[0, 0] + covariance[1, 1], covariance[2, 2]))
    metres, radians = np.sqrt(np.median(squares, axis=0))
    return float(metres), float(np.degrees(radians))


def judge(world: str, seed: int) -> dict[str, list[float]]:
    """ATE (m, degrees) and RPE (m, degrees) of each stage of one drive."""
    log = simulate(
        make_world(world, np.random.default_rng(seed)),
        RobotConfig(),
        OdometryNoise(),
        LidarConfig(sigma_range_m=NOISE_M),
        np.random.default_rng(seed),
    )
    reports, full = map_drive(log.measurements, Configuration(), 0)
    with patch("gridslam.tracking.tracker.match_to_surfaces", lambda recent, own, found: found.pose):
        cells = track(log.measurements, Tracker())
    with patch.object(SmoothedPose, "follow", lambda self, increment, motion, matched: SmoothedPose(matched)):
        matches = online(log.measurements)
    stages = {
        "odometry": np.array([odometry.pose for odometry, _ in log.measurements if odometry is not None]),
        "tracker, cells": cells,
        "tracker": track(log.measurements, Tracker()),
        "best particle": matches,
        "online": np.array([report.pose for report in reports]),
        "final": full.poses,
    }
    found = {}
    for stage, poses in stages.items():
        estimate = Trajectory(log.truth.stamps_ns, between(poses[0], poses))
        ate = absolute_errors(estimate, log.truth)
        rpe = relative_errors_by_distance(estimate, log.truth, 1.0)
        found[stage] = [ate.trans_rmse_m, ate.rot_rmse_deg, rpe.trans_rmse_m, rpe.rot_rmse_deg]
    metres, degrees = bound(log.measurements)
    found["bound"] = [metres, degrees, 2**0.5 * metres, 2**0.5 * degrees]
    return found


def main() -> None:
    """Print a table, and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("worlds", nargs="*", default=WORLDS)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=201)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    rows = []
    print("| world | stage | ATE (m, degrees) | RPE over 1 m (m, degrees) |\n| --- | --- | --- | --- |")
    for world in options.worlds:
        drives = [judge(world, seed) for seed in range(options.first, options.first + options.seeds)]
        for stage in drives[0]:
            ate_m, ate_deg, rpe_m, rpe_deg = np.sqrt(np.mean(np.square([drive[stage] for drive in drives]), axis=0))
            rows.append(
                {"world": world, "stage": stage, "ate_m": ate_m, "ate_deg": ate_deg, "rpe_m": rpe_m, "rpe_deg": rpe_deg}
            )
            print(f"| {world} | {stage} | {ate_m:.4f}, {ate_deg:.3f} | {rpe_m:.4f}, {rpe_deg:.3f} |", flush=True)
    if options.out is not None:
        write_document(options.out, "python benchmarks/error_budget.py", seeds=options.seeds, rows=rows)


if __name__ == "__main__":
    main()
