"""Bare corridors: how far the way is from the truth, and which key scans are reported as degenerate.

Two rooms are joined by a bare corridor, askew to the map cells, and driven once, with odometry without systematic
errors. The stretch from the first to the last scan that sees nothing but walls along the corridor is compared with the
truth. A scan is blind if none of its beams reaches another wall or an end of one of the corridor's walls; it is seen if
five or more hit another wall; what lies between is not judged.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gridslam.config import Configuration
from gridslam.geometry.se2 import between, compose
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, simulate
from gridslam.sim.lidar import cast_rays
from simulated import map_drive

WIDTH_M = 2.0
ROOM_M = (6.0, 5.0)
TURN_RAD = 0.3  # of the corridor against the map's cells
SEEN_BEAMS = 5
UNBIASED = OdometryNoise(distance_scale=1.0, turn_scale=1.0, bias_rad_per_m=0.0)


class Drive(NamedTuple):
    """One drive: ways over the true one, and shares of the key scans that are reported as degenerate."""

    blind_scans: int
    odometry: float
    online: float
    full: float
    flagged_blind: float
    flagged_seen: float


def bare_corridor(length_m: float) -> tuple[World, np.ndarray]:
    """A corridor between two rooms, and which of its walls (S,) lie along it."""
    depth, side = ROOM_M[0], ROOM_M[1] / 2
    half = WIDTH_M / 2
    walls = [(0, -half, length_m, -half), (0, half, length_m, half)]
    for begin, end in ((-depth, 0.0), (length_m, length_m + depth)):
        far = begin if begin < 0 else end
        near = end if begin < 0 else begin
        walls += [(begin, -side, end, -side), (begin, side, end, side), (far, -side, far, side)]
        walls += [(near, -side, near, -half), (near, half, near, side)]
        for x, y in ((begin + 1.0, 1.6), (begin + 4.2, -1.7)):  # pillars
            corners = [(x - 0.25, y - 0.25), (x + 0.25, y - 0.25), (x + 0.25, y + 0.25), (x - 0.25, y + 0.25)]
            walls += [(*a, *b) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    segments = np.array(walls, np.float64)
    c, s = np.cos(TURN_RAD), np.sin(TURN_RAD)
    rotation = np.array([[c, s], [-s, c]])
    turned = np.concatenate([segments[:, :2] @ rotation, segments[:, 2:] @ rotation], axis=1)
    route = np.array([(-4.5, 0.0), (length_m + 4.5, 0.0)]) @ rotation
    along = np.zeros(len(walls), np.bool_)
    along[:2] = True
    return World.of("bare corridor", turned, route), along


def count_fixing_beams(world: World, along: np.ndarray, truth: np.ndarray, lidar: LidarConfig) -> np.ndarray:
    """Beams (N,) of noise-free scans at poses (N, 3) that end on a wall which is not along the corridor."""
    bearings = np.linspace(-0.5, 0.5, lidar.beams) * lidar.field_of_view_rad
    lasers = compose(truth, np.array([lidar.x_m, lidar.y_m, lidar.heading_rad]))
    beside, across = (cast_rays(world.walls[walls], lasers, bearings) for walls in (along, ~along))
    return np.count_nonzero((across < beside) & (across < lidar.range_max_m), axis=1)


def drive(length_m: float, range_m: float, seed: int) -> Drive:
    """Map one drive."""
    world, along = bare_corridor(length_m)
    lidar = LidarConfig(range_max_m=range_m)
    rng = np.random.default_rng([seed, int(length_m), int(range_m)])
    log = simulate(world, RobotConfig(), UNBIASED, lidar, rng)
    reports, full = map_drive(log.measurements, Configuration(), seed)
    truth = log.truth.poses
    fixing = count_fixing_beams(world, along, truth, lidar)
    c, s = np.cos(TURN_RAD), np.sin(TURN_RAD)
    places = truth[:, :2] @ np.array([c, s])
    blind = (fixing == 0) & (places > 0) & (length_m - places > range_m)  # the laser looks ahead
    is_key = np.array([report.skipped is None for report in reports])
    flagged = np.array([report.degenerate_direction is not None for report in reports])
    stretch = np.flatnonzero(fixing < SEEN_BEAMS)
    first, last = (stretch[0], stretch[-1]) if len(stretch) else (0, len(truth) - 1)

    def way(poses: np.ndarray) -> float:
        return float(np.hypot(*between(poses[first], poses[last])[:2]) / np.hypot(*(truth[last] - truth[first])[:2]))

    def share(chosen: np.ndarray) -> float:
        return float(flagged[chosen].mean()) if chosen.any() else float("nan")

    online = np.array([report.pose for report in reports])
    return Drive(
        int((blind & is_key).sum()),
        way(log.odometry.poses),
        way(online),
        way(full.poses),
        share(blind & is_key),
        share((fixing >= SEEN_BEAMS) & is_key),
    )
