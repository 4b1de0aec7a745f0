"""Peak memory of `gridslam map` on drives that fill it: long corridors, open grounds, and logs given.

python benchmarks/memory.py [LOG ...]
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path

import numpy as np

import closure_worlds
from closure_worlds import Drive
from gridslam.io.carmen.writer import write_carmen
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World
from gridslam.sim.floor_plan import box, clearance, furniture, join, pillar
from gridslam.sim.world import tour, wander
from gridslam.types import FloatArray
from measure import map_timed
from report import table

__all__ = ["grounds", "main"]

_WIDTH_M, _HEIGHT_M = 460.0, 230.0
_XS, _YS = (12.0, 121.0, 230.0, 339.0, 448.0), (12.0, 115.0, 218.0)
"""Paths run along these lines, and eight pavilions stand between them."""


def grounds(seed: int, length_m: float = 1500.0) -> Drive:
    """A robot outside, about a hospital's pavilions: trees, parked cars, and else open ground; it sees up to 80 m."""
    rng = np.random.default_rng(seed)
    corners = [(x, y) for y in _YS for x in _XS]
    across = len(_XS)
    passages = [(k, k + 1) for k in range(len(corners)) if k % across < across - 1]
    passages += [(k, k + across) for k in range(len(corners) - across)]
    route, _ = wander(tour(np.array(corners), passages, length_m, rng), rng, aside_m=0.5)
    pavilions = [_pavilion(*left, *low, rng) for low in pairwise(_YS) for left in pairwise(_XS)]
    places = rng.uniform((0.0, 0.0), (_WIDTH_M, _HEIGHT_M), (500, 2))
    trees = [pillar(x, y, float(rng.uniform(0.1, 0.4)), 8) for x, y in places[:400].tolist()]
    cars = [furniture(x, y, 4.3, 1.8, float(rng.uniform(0, 3))) for x, y in places[400:].tolist()]
    lanes = np.array([(*corners[a], *corners[b]) for a, b in passages])
    beside = [thing for thing in [*trees, *cars] if clearance(lanes, thing.reshape(-1, 2)).min() > 1.2]
    world = World.of("grounds", join(box(-4, -4, _WIDTH_M + 4, _HEIGHT_M + 4), *pavilions, *beside), route)
    robot = RobotConfig(v_max_m_s=0.8, turning_radius_m=0.7)
    lidar = LidarConfig(range_max_m=80.0, sigma_range_m=0.015)
    return Drive(f"grounds {seed}", world, robot, OdometryNoise(bias_rad_per_m=1e-3, alpha2=1e-4), lidar, seed)


def _pavilion(left: float, right: float, low: float, high: float, rng: np.random.Generator) -> FloatArray:
    """A long house and its wings, in the middle of a rectangle of lawn."""
    wide, deep = rng.uniform((40, 10), (70, 16)).tolist()
    x, y = (left + right - wide) / 2 + rng.uniform(-8, 8), (low + high - deep) / 2 + rng.uniform(-15, 15)
    wings = [box(x + s * wide, y + deep, x + s * wide + 9, y + deep + rng.uniform(4, 12)) for s in (0.1, 0.6)]
    return join(box(x, y, x + wide, y + deep), *wings)


def main(logs: Sequence[str]) -> None:
    """Print a table of peak memory and CPU time."""
    rows: list[list[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        runs = [(Path(log).name, Path(log), 30) for log in logs]
        for drive, range_m in product((closure_worlds.campus(0), grounds(0)), (30, 80)):
            path = Path(folder) / f"{drive.world.name}.clf"
            if not path.exists():
                write_carmen(path, drive.stream().measurements)
            runs.append((f"{drive.name}, beams up to {range_m} m", path, range_m))
        for name, path, range_m in runs:
            run = map_timed(path, "--set", f"range_max_m={range_m}")
            width, height = (run.document["filter"][f"map_{side}_m"] for side in ("width", "height"))
            rows.append([name, f"{width:.0f} x {height:.0f}", run.peak_mb, run.cost.cpu_s])
    print(table(["log", "map, m", "peak MB", "CPU s"], rows))


if __name__ == "__main__":
    main(sys.argv[1:])
