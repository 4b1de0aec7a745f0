"""Makes the animations of the pages, each from a run of our own: ``python docs/scripts/animations.py [NAME ...]``.

Worlds, noise and seeds are fixed, so that the same version makes the same animations. Each comes with a still, which is
shown where the reader asks for reduced motion (docs/_static/gridslam.css). All take a minute.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from animations_of_parts import bayes_filter, resampling_wheel
from drives import drive, extent, mapped, pasts
from film import FRAME_MS, HOLD_MS, Film
from numpy.typing import NDArray
from panels import ORANGE, VIOLET, Chart, Panel

from gridslam import Configuration, GridFastSlam, GridFastSlamState, OccupancyGrid, build, map_log, run
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.models import DiffusionMotion
from gridslam.models.landmark import LandmarkObservations, RangeBearing
from gridslam.sim import LidarConfig, OdometryNoise
from gridslam.slam.landmarks.ekf_slam import EkfSlam
from gridslam.types import FloatArray, LaserScan, StepReport
from gridslam.viz.canvas import CLOSURE, FREE, LOST, OCCUPIED, TRUTH

DATA = Path(os.environ.get("GRIDSLAM_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def growing_map() -> None:
    """Map the Intel Research Lab with the default configuration: the map and the trajectory grow."""
    film = Film("growing_map", [("trajectory, coloured by time", VIOLET), ("robot", ORANGE)], quality=45)
    stamps: list[int] = []
    moments: list[tuple[int, OccupancyGrid, FloatArray]] = []

    def watch(report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        if report.skipped is None:
            stamps.append(report.stamp_ns)
            if len(stamps) % 18 == 1:
                path = state.ancestry.trajectory(state.best)
                moments.append((stamps[-1], state.maps.occupancy(state.best), path))

    result = map_log(DATA / "intel.clf.bz2", seed=0, observers=[watch])
    poses = result.trajectory.poses
    box = [*(poses[:, :2].min(0) - 4.0), *(poses[:, :2].max(0) + 4.0)]
    for stamp, grid, path in [*moments, (0, result.map, poses)]:
        panel = Panel(f"{(stamp - stamps[0]) / 60e9:.0f} min of driving" if stamp else "the final map", box, 480)
        panel.grid(grid)
        if len(path) > 1:
            panel.timed(path[:, :2], 1.5)
        panel.robot(path[-1], ORANGE, 0.8)
        film.add([panel], hold=not stamp)
    film.still = len(film.frames) - 1
    film.save()


def particles_at_a_loop() -> None:
    """Thirty particles on their first round of a block: they spread, the loop closes, the wrong ones die out."""
    log = drive("loop")
    film = Film(
        "particles_at_a_loop", [("particles and their pasts", CLOSURE), ("N_eff / 30", TRUTH), ("spread, m", ORANGE)]
    )
    told: list[tuple[float, float]] = []
    x0, y0, x1, y1 = extent(mapped(log, range(0, len(log), 4)).occupancy(0))

    def watch(report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        if report.skipped is not None or len(told) > 124:
            return
        away = state.poses[:, :2] - state.poses[:, :2].mean(0)
        told.append((report.n_eff / 30, float(np.sqrt(np.square(away).sum(1).mean()))))
        resampled = report.parents is not None
        if len(told) % 2 and not resampled and not 86 < len(told) < 100:
            return
        paths = pasts(state)
        whole = Panel(f"key scan {len(told)}{', resampled' if resampled else ''}", (x0, y0, x1, y1), 240)
        whole.grid(state.maps.occupancy(state.best))
        for path in paths:
            whole.line(path[:, :2], CLOSURE, 1.0)
        whole.dots(paths[:, -1, :2], ORANGE, 4.0)
        at = state.poses[:, :2].mean(0)
        tall = whole.page.height
        near = Panel("around the robot", (at[0] - 1.2, at[1] - 1.4, at[0] + 1.2, at[1] + 1.4), round(tall * 2.4 / 2.8))
        near.grid(state.maps.occupancy(state.best))
        for path in paths:
            near.line(path[-14:, :2], CLOSURE, 1.0)
        near.dots(paths[:, -1, :2], ORANGE, 7.0)
        chart = Chart("N_eff and spread", (0, 0, 125, 1.05), 230, tall)
        chart.values((50, 100), (0.25, 0.5, 1.0))
        keys, (n_eff, spread) = np.arange(len(told), dtype=np.float64), np.array(told).T
        if len(told) > 1:
            chart.curve(keys, n_eff, TRUTH)
            chart.curve(keys, spread, ORANGE)
        film.add([whole, near, chart], hold=resampled or len(told) == 124)
        if resampled and not film.still:
            film.still = len(film.frames) - 1

    run(log.measurements, GridFastSlam(particles_min=30), rng=np.random.default_rng(0), observers=[watch])
    if not film.still:
        raise SystemExit("particles_at_a_loop: expected a resampling, got none; choose another drive")
    film.save()


def kidnapping() -> None:
    """A localized robot is carried elsewhere without odometry: it gets lost, and is localized again."""
    grid = mapped(drive("demo", 1), range(0, 700, 2)).occupancy(0)
    log = drive("demo", 2, lidar=LidarConfig(rate_hz=4.0, beams=90, range_max_m=6.0))
    truth = between(drive("demo", 1).truth.poses[0], log.truth.poses)
    film = Film(
        "kidnapping", [("particles", CLOSURE), ("truth", TRUTH), ("reported", ORANGE), ("reported while lost", LOST)]
    )
    slam, rng = MonteCarloLocalization(KnownMap(grid)), np.random.default_rng(1)
    taken, put = 300, 460
    state = slam.init_gaussian(truth[270], np.diag([0.01, 0.01, 0.003]), rng)
    carried = log.measurements[taken - 1].odometry.pose, log.measurements[put].odometry.pose
    box = extent(grid)
    lost_for, found, most = 0, 0, 0
    for k in (*range(270, taken), *range(put, put + 110)):
        odometry, scan = log.measurements[k]
        if k >= put:  # the wheels did not turn while it was carried
            odometry = replace(odometry, pose=compose(carried[0], between(carried[1], odometry.pose)))
        state, report = slam.step(state, odometry, scan, rng)
        if report.skipped is not None and k != put:
            continue
        what = "lost" if report.lost else "localized"
        lost_for += report.lost and k >= put
        back = bool(lost_for) and not report.lost
        found += back
        panel = Panel(
            f"{'after' if k >= put else 'before'} the kidnapping: {what}, {report.particles} particles", box, 460
        )
        panel.grid(grid)
        if report.poses is not None:
            panel.dots(report.poses[:3000, :2], CLOSURE, 3.0)
        panel.robot(report.pose, LOST if report.lost else ORANGE, 1.2, 9)
        panel.robot(truth[k], TRUTH, 1.2, 4)
        film.add([panel], hold=k == put or (found == 1 and back))
        if k > put and film.durations[-1] == FRAME_MS:
            film.durations[-1] = 2 * FRAME_MS
        places = 0 if report.poses is None else len(np.unique(report.poses[:, :2].round(), axis=0))
        if report.lost and places > most:
            most, film.still = places, len(film.frames) - 1
        if found > 12:
            break
    if found < 2:
        raise SystemExit("kidnapping: expected that the robot is localized again; choose another drive")
    film.save()


def closure() -> None:
    """A map bent by odometry while the laser was covered, and what is left of the bend when the loop is closed."""
    bad = OdometryNoise(turn_scale=0.85, bias_rad_per_m=0.02)
    log = drive("demo", 4, bad, LidarConfig(rate_hz=4.0, beams=90))
    measurements = list(log.measurements)
    for k in range(110, 140):  # the laser is covered for 7.5 s
        scan = measurements[k].scan
        nothing = LaserScan.from_ranges(
            scan.stamp_ns, np.full(len(scan), np.nan), scan.geometry, range_max_m=scan.range_max_m
        )
        measurements[k] = measurements[k]._replace(scan=nothing)
    past: list[tuple[FloatArray, tuple[tuple[int, int], ...]]] = []
    points: list[FloatArray] = []
    closures: tuple[tuple[int, int], ...] = ()

    def watch(report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        nonlocal closures
        closures += report.closures
        if report.skipped is None:
            points.append(ends[report.stamp_ns])
            past.append((state.ancestry.trajectory(state.best), closures))

    ends = {m.scan.stamp_ns: m.scan.beams(0.05, 12.0).ends[::2] for m in measurements}
    run(measurements, build(Configuration(particles=1)), rng=np.random.default_rng(0), observers=[watch])
    film = Film("closure", [("ends of the beams", OCCUPIED), ("loop closures", CLOSURE)])
    pairs = [(before, after[: len(before)]) for (before, _), (after, _) in pairwise(past)]
    moved = [float(np.hypot(*(after - before)[:, :2].T).max()) for before, after in pairs]
    if max(moved) < 1.0:
        raise SystemExit(f"closure: expected a correction by metres, got {max(moved):.2f} m; choose another drive")
    jump = int(np.argmax(moved))  # the last key scan before the correction
    everything = np.concatenate(
        [transform_points(pose, e) for pose, e in zip(past[jump][0], points[: jump + 1], strict=True)]
    )
    box = [*(everything.min(0) - 0.5), *(everything.max(0) + 0.5)]

    def frame(head: str, poses: FloatArray, marks: Sequence[tuple[int, int]], hold: bool = False) -> None:
        panel = Panel(head, box, 460)
        panel.page.paste(FREE, (0, 0, *panel.page.size))
        seen = np.concatenate([transform_points(pose, e) for pose, e in zip(poses, points[: len(poses)], strict=True)])
        panel.dots(seen, OCCUPIED, 1.5)
        panel.timed(poses[:, :2], 2.0)
        for one, other in marks:
            panel.line(poses[[one, other], :2], CLOSURE, 2.0)
        panel.robot(poses[-1], ORANGE, 1.0)
        film.add([panel], hold)

    for k in range(8, jump, 4):
        frame(f"key scan {k}", past[k][0], ())
    before, after = past[jump][0], past[jump + 1][0][: len(past[jump][0])]
    frame("places that are one are recognized", before, past[jump + 1][1], hold=True)
    film.still = len(film.frames) - 1
    for share in np.linspace(0, 1, 16)[1:]:
        eased = share * share * (3 - 2 * share)
        frame("the past is corrected", before + eased * between_headings(before, after), past[jump + 1][1])
    frame("the past is corrected", after, past[jump + 1][1], hold=True)
    for k in range(jump + 1, len(past), 4):
        frame(f"key scan {k}", past[k][0], ())
    frame("the whole drive", past[-1][0], (), hold=True)
    film.save()


def between_headings(before: FloatArray, after: FloatArray) -> FloatArray:
    """Differences (T, 3) of poses, headings along the shorter arc."""
    difference = after - before
    difference[:, 2] = wrap(difference[:, 2])
    return difference


def covariance_ellipses() -> None:
    """EKF SLAM on a circle among landmarks: uncertainty grows with the way, and shrinks everywhere at the closure."""
    sensor, motion = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02), DiffusionMotion(0.05, 0.03)
    rng, increment, reach = np.random.default_rng(3), np.array([0.2, 0.0, 0.05]), 3.5
    angles = math.tau * np.arange(12) / 12
    landmarks = np.array([0.0, 4.0]) + 6.0 * np.stack([np.cos(angles), np.sin(angles)], 1)
    film = Film(
        "covariance_ellipses",
        [("truth", TRUTH), ("robot, 3 sigma", ORANGE), ("landmarks, 3 sigma", VIOLET), ("observed", CLOSURE)],
    )
    slam = EkfSlam(sensor)
    state, pose, path, estimates = slam.init(), np.zeros(3), [np.zeros(3)], [np.zeros(3)]
    last: dict[int, int] = {}
    closes_at = 0
    for k in range(1, 161):
        pose = motion(increment)(pose[None], rng)[0]
        seen: NDArray[np.int64] = np.flatnonzero(np.hypot(*(landmarks - pose[:2]).T) < reach)
        z = sensor.linearize(pose, landmarks[seen])[0].reshape(-1, 2) + [0.1, 0.02] * rng.standard_normal(
            (len(seen), 2)
        )
        state, _ = slam.step(state, motion(increment), LandmarkObservations.of(z, seen))
        path.append(pose)
        estimates.append(state.pose.copy())
        found = slam.landmark_map(state)
        sigma = math.sqrt(np.trace(state.pose_covariance[:2, :2]))
        closed = not closes_at and any(k - last.get(name, k) > 60 for name in seen.tolist())
        last.update(dict.fromkeys(seen.tolist(), k))
        if closed:
            closes_at, film.still, film.durations[-1] = k, len(film.frames) - 1, HOLD_MS
        if k % 2 and not closed:
            continue
        panel = Panel(f"step {k}: the robot's standard deviation is {sigma:.2f} m", [-8.2, -3.8, 8.2, 11.8], 520)
        panel.page.paste(FREE, (0, 0, *panel.page.size))
        for name in seen.tolist():
            panel.line(np.stack([state.pose[:2], found.positions[found.names.tolist().index(name)]]), CLOSURE, 1.5)
        panel.line(np.array(estimates)[:, :2], ORANGE, 3.0)
        panel.line(np.array(path)[:, :2], TRUTH, 1.2)
        panel.dots(landmarks, TRUTH, 6.0)
        for mean, covariance in zip(found.positions, found.covariances, strict=True):
            panel.ring(mean, covariance, VIOLET, 3.0)
        panel.ring(state.pose[:2], state.pose_covariance[:2, :2], ORANGE, 3.0)
        panel.robot(state.pose, ORANGE, 0.5)
        film.add([panel], hold=closed or k == 160)
    film.save()


ANIMATIONS = (
    growing_map,
    particles_at_a_loop,
    kidnapping,
    closure,
    covariance_ellipses,
    resampling_wheel,
    bayes_filter,
)

if __name__ == "__main__":
    for make in ANIMATIONS:
        if len(sys.argv) == 1 or make.__name__ in sys.argv[1:]:
            make()
