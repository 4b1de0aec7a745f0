"""Logs to run: those found in a folder, and simulated ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from aliasing_worlds import make_world
from gridslam import Trajectory
from gridslam.io.carmen.writer import write_carmen
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, simulate
from gridslam.sim.floor_plan import box, join, place
from gridslam.types import FloatArray

_CORRIDOR_M = 2.4


@final
@dataclass(frozen=True)
class Log:
    """A log, and what is known to be true of it: a file of relations, or the true trajectory."""

    name: str
    path: Path
    relations: Path | None = None
    truth: Trajectory | None = None


def find(folder: Path) -> list[Log]:
    """CARMEN logs in a folder, those with relations first; none where there is no such folder."""
    paths = sorted(path for path in folder.glob("*.clf*") if path.is_file())
    logs = [Log(path.name.partition(".")[0], path, _beside(path)) for path in paths]
    return sorted(logs, key=lambda log: (log.relations is None, log.name != "intel", log.name))


def _beside(path: Path) -> Path | None:
    relations = path.with_name(path.name.partition(".")[0] + ".relations")
    return relations if relations.is_file() else None


def simulated(
    world: str | World,
    folder: Path,
    *,
    seed: int = 0,
    beams: int = 180,
    fov_deg: float = 180.0,
    v_max_m_s: float = 0.6,
) -> Log:
    """Simulate a world, given by name or built, and write its log."""
    rng = np.random.default_rng(seed)
    lidar = LidarConfig(beams=beams, field_of_view_rad=math.radians(fov_deg))
    built = make_world(world, rng) if isinstance(world, str) else world
    run = simulate(built, RobotConfig(v_max_m_s=v_max_m_s), OdometryNoise(), lidar, rng)
    path = folder / f"{built.name}-{beams}-{seed}.clf"
    write_carmen(path, run.measurements)
    return Log(f"{built.name} (simulated)", path, truth=run.truth)


def ring(side_m: float, rng: np.random.Generator) -> World:
    """A corridor around a square building, cabinets on both sides; the route goes along three of its four sides.

    What the robot sees at a time is alike at every size, and it never comes back to where it was.
    """
    inner = side_m - _CORRIDOR_M
    sides = [(0, 0, 0), (side_m, 0, math.pi / 2), (side_m, side_m, math.pi), (0, side_m, -math.pi / 2)]
    cabinets = [place(_cabinets(side_m, rng), side) for side in sides]
    walls = join(box(0, 0, side_m, side_m), box(_CORRIDOR_M, _CORRIDOR_M, inner, inner), *cabinets)
    near, far = _CORRIDOR_M / 2, side_m - _CORRIDOR_M / 2
    return World.of(f"ring{side_m:g}", walls, [(4.0, near), (far, near), (far, far), (4.0, far)])


def _cabinets(length_m: float, rng: np.random.Generator) -> FloatArray:
    """Boxes along a corridor on the x axis, clear of its corners, now on one wall and now on the other."""
    boxes, x = [], 1.5 * _CORRIDOR_M
    while (x := x + rng.uniform(1.0, 5.0)) < length_m - 2 * _CORRIDOR_M:
        width, depth = rng.uniform(0.5, 1.8), rng.uniform(0.25, 0.5)
        y = 0.0 if rng.random() < 0.5 else _CORRIDOR_M - depth
        boxes.append(box(x, y, x + width, y + depth))
        x += width
    return join(*boxes)
