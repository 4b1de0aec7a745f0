"""Where do the centimetres go? Errors of each stage against exact truth, beside what the beams' noise allows.

    python benchmarks/error_budget.py [WORLD ...] [--seeds 2] [--out FILE] [--lasers]

Stages: the odometry; the tracker that matches to cells alone; the tracker; the best particle, matched to its map at key
scans; the online trajectory (the same, smoothed); the final trajectory. "bound" is that of a scan in a known map: no
pose is better than its beams (Censi, On achievable accuracy for range-finder localization, 2007), and two of them a
metre apart err by the root of two of it. Of a simulated drive with range noise of 1 cm, in metres and degrees: over the
whole way, aligned (ATE), and over one metre of it (RPE), root mean squares.

With `--lasers`, of lasers of other kinds, in random buildings: the odometry, the online and the final trajectory,
beside the bound of the joint problem, which is what the noise of ranges and odometry allows all key scans together
(samples of its posterior at the true poses), and the error of distances over 20 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any
from unittest.mock import patch

import numpy as np

from gridslam.config import Configuration, build
from gridslam.evaluation import absolute_errors, relative_errors_by_distance
from gridslam.geometry.se2 import adjoint, between, compose
from gridslam.grid.scan_batch import ScanBatch
from gridslam.io.measurement import Measurement
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.surfaces import Surfaces
from gridslam.pipeline import run
from gridslam.scan import LaserScan
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.slam.full_slam.surface_adjustment import LINE_REACH_M, select_pairs, share_information
from gridslam.slam.grid_fastslam.smoothed_pose import SmoothedPose
from gridslam.tracking.recent_scans import RecentScans
from gridslam.tracking.tracker import Tracker
from gridslam.types import FloatArray, Trajectory
from measure import make_parser, write_document
from simulated import map_drive, thin

WORLDS = ("demo", "rooms", "loop", "hall", "random")
NOISE_M = 0.01
LASERS = {
    "180 degrees, 1 cm": LidarConfig(sigma_range_m=NOISE_M),
    "180 degrees, 3 cm": LidarConfig(sigma_range_m=0.03),
    "60 degrees, 3 cm": LidarConfig(beams=60, field_of_view_rad=math.radians(60), sigma_range_m=0.03),
    "270 degrees, 3 cm": LidarConfig(beams=270, field_of_view_rad=math.radians(270), sigma_range_m=0.03),
    "360 degrees, 3 cm": LidarConfig(beams=360, field_of_view_rad=math.tau, sigma_range_m=0.03),
    "270 degrees, 1080 beams, 3 cm": LidarConfig(beams=1080, field_of_view_rad=math.radians(270), sigma_range_m=0.03),
    "180 degrees, 3 cm, over 20 m in a hall": LidarConfig(sigma_range_m=0.03),
    "180 degrees, 1 cm, a scan every metre": LidarConfig(sigma_range_m=NOISE_M),
    "90 degrees, 2 cm": LidarConfig(beams=90, field_of_view_rad=math.radians(90), sigma_range_m=0.02),
    "360 degrees, 36 beams, 6 m, 2 cm": LidarConfig(
        beams=36, field_of_view_rad=math.tau, range_max_m=6.0, sigma_range_m=0.02
    ),
    "360 degrees, 3.5 m, 2 cm": LidarConfig(beams=360, field_of_view_rad=math.tau, range_max_m=3.5, sigma_range_m=0.02),
    "360 degrees, 5 m, 2 % of range": LidarConfig(
        beams=360, field_of_view_rad=math.tau, range_max_m=5.0, sigma_range_m=0.0, sigma_range_share=0.02
    ),
    "240 degrees, 4 m, 2 cm": LidarConfig(
        beams=240, field_of_view_rad=math.radians(240), range_max_m=4.0, sigma_range_m=0.02
    ),
}
FAR_M = 20.0
SAMPLES = 20
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


def simulated_drive(world: str, seed: int, lidar: LidarConfig = LASERS["180 degrees, 1 cm"]) -> SimulatedLog:
    """A drive through a world of that name; both are drawn by the seed."""
    drawn = make_world(world, np.random.default_rng(seed))
    return simulate(drawn, RobotConfig(), OdometryNoise(), lidar, np.random.default_rng(seed))


def judge(world: str, seed: int, *, with_best: bool = True) -> dict[str, list[float]]:
    """ATE (m, degrees) and RPE (m, degrees) of each stage of one drive; the best particle's takes a run of its own."""
    log = simulated_drive(world, seed)
    reports, full = map_drive(log.measurements, Configuration(), 0)
    with patch.object(RecentScans, "match", lambda recent, ends, guess: guess):
        cells = track(log.measurements, Tracker())
    stages = {
        "odometry": np.array([odometry.pose for odometry, _ in log.measurements if odometry is not None]),
        "tracker, cells": cells,
        "tracker": track(log.measurements, Tracker()),
        "online": np.array([report.pose for report in reports]),
        "final": full.poses,
    }
    if with_best:
        with patch.object(SmoothedPose, "follow", lambda self, increment, motion, matched: SmoothedPose(matched)):
            stages["best particle"] = online(log.measurements)
    found = {}
    for stage, poses in stages.items():
        found[stage] = score(poses, log.truth)[:4]
    metres, degrees = bound(log.measurements)
    found["bound"] = [metres, degrees, 2**0.5 * metres, 2**0.5 * degrees]
    return found


def joint_bound(scans: Sequence[LaserScan], truth: Trajectory, noise_m: float) -> list[float]:
    """ATE and RPE (m, degrees) that the noise of ranges and odometry allows K key scans, by samples about the truth."""
    surfaces = Surfaces.of(ScanBatch.of([scan.beams(0.05, 30.0) for scan in scans]), LINE_REACH_M)
    poses = truth.poses
    pairs = select_pairs(poses)
    found = surfaces.match(poses, pairs, 0.4, 10.0, by_incidence=True)
    information = 0.5 / noise_m**2 * share_information(pairs)[:, None, None] * found.information
    steps = np.column_stack([np.arange(len(poses) - 1), np.arange(1, len(poses))])
    moved = np.abs(between(poses[:-1], poses[1:]))
    metres, radians = np.hypot(moved[:, 0], moved[:, 1]), moved[:, 2]
    noise = OdometryNoise()
    along = noise.alpha3 * metres + noise.alpha4 * radians
    turned = noise.alpha1 * radians + noise.alpha2 * metres
    odometry = np.column_stack([along, 0.25 * metres**2 * turned + 0.25 * along, turned])  # across: turned on the way
    pairs = np.concatenate([pairs, steps])
    information = np.concatenate([information, np.eye(3) / odometry[:, None, :]])
    slopes = -adjoint(between(poses[pairs[:, 1]], poses[pairs[:, 0]]))
    whole = np.diag([1e12] * 3 + [0.0] * (3 * len(poses) - 3))  # the first pose is given
    for (from_, to), slope, own in zip((3 * pairs).tolist(), slopes, information, strict=True):
        first, second = slice(from_, from_ + 3), slice(to, to + 3)
        whole[first, first] += slope.T @ own @ slope
        whole[second, second] += own
        whole[first, second] += slope.T @ own
        whole[second, first] += own @ slope
    root = np.linalg.cholesky(whole)
    normal = np.random.default_rng(0).standard_normal((3 * len(poses), SAMPLES))
    drawn = np.linalg.solve(root.T, normal).T.reshape(SAMPLES, -1, 3)
    rows = [score(compose(poses, error), truth)[:4] for error in drawn]
    return np.sqrt(np.mean(np.square(rows), axis=0)).tolist()


def score(poses: FloatArray, truth: Trajectory) -> list[float]:
    """ATE (m, degrees), RPE over 1 m (m, degrees) and error of distances over 20 m (%), root mean squares."""
    estimate = Trajectory(truth.stamps_ns, between(poses[0], poses))
    ate = absolute_errors(estimate, truth)
    rpe = relative_errors_by_distance(estimate, truth, 1.0)
    some = slice(None, None, 1 + len(poses) // 300)
    true, found = (np.hypot(*(p[some, None, :2] - p[some, :2]).transpose(2, 0, 1)) for p in (truth.poses, poses))
    ratios = found[true > FAR_M] / true[true > FAR_M] - 1
    far = 100 * float(np.sqrt(np.mean(np.square(ratios)))) if len(ratios) else 0.0
    return [ate.trans_rmse_m, ate.rot_rmse_deg, rpe.trans_rmse_m, rpe.rot_rmse_deg, far]


def judge_laser(name: str, world: str, seed: int) -> dict[str, list[float]]:
    """Scores of the odometry, the online and the final trajectory, and the bound, of one drive."""
    lidar = LASERS[name]
    log = simulated_drive(world, seed, lidar)
    measurements, truth = list(log.measurements), log.truth
    if "every metre" in name:
        kept = thin(truth.poses, 1.0, 0.5)
        measurements = [measurements[k] for k in kept]
        truth = Trajectory(truth.stamps_ns[kept], truth.poses[kept])
    reports, full = map_drive(measurements, Configuration(), 0)
    keys = thin(truth.poses, 0.4, 0.25)
    far_m = np.median([np.median(scan.ranges[scan.ranges < lidar.range_max_m]) for _, scan in measurements])
    noise_m = lidar.sigma_range_m + lidar.sigma_range_share * float(far_m)
    return {
        "odometry": score(np.array([odometry.pose for odometry, _ in measurements if odometry is not None]), truth),
        "online": score(np.array([report.pose for report in reports]), truth),
        "final": score(full.poses, truth),
        "bound": joint_bound(
            [measurements[k].scan for k in keys], Trajectory(truth.stamps_ns[keys], truth.poses[keys]), noise_m
        ),
    }


def main() -> None:
    """Print a table, and write it."""
    parser = make_parser(__doc__)
    parser.add_argument("worlds", nargs="*", default=WORLDS)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=201)
    parser.add_argument("--lasers", action="store_true")
    parser.add_argument("--only", nargs="*", default=LASERS)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    kinds = {laser: "hall" if "20 m" in laser else "random" for laser in options.only}
    kinds = kinds if options.lasers else dict.fromkeys(options.worlds, "")
    print("| kind | stage | ATE (m, degrees) | RPE over 1 m (m, degrees) | over 20 m (%) |\n" + "| --- " * 5 + "|")
    for kind, world in kinds.items():
        seeds = range(options.first, options.first + options.seeds)
        drives = [judge_laser(kind, world, seed) if world else judge(kind, seed) for seed in seeds]
        for stage in drives[0]:
            values = np.sqrt(np.mean(np.square([drive[stage] for drive in drives]), axis=0)).tolist()
            names = ("ate_m", "ate_deg", "rpe_m", "rpe_deg", "far_percent")
            rows.append({"laser" if world else "world": kind, "stage": stage} | dict(zip(names, values, strict=False)))
            far = "".join(f"{value:.2f}" for value in values[4:] if value)
            print(f"| {kind} | {stage} | {values[0]:.4f}, {values[1]:.3f} | {values[2]:.4f}, {values[3]:.3f} | {far} |")
    write_document(options.out, seeds=options.seeds, rows=rows)


if __name__ == "__main__":
    main()
