"""How exactly is a map aligned with an architect's plan? Plans of the true walls, turned and scaled, partly wrong.

    python benchmarks/plan_alignment.py [SEED ...] [--out FILE]

Of the walls of each plan 10 % are wrong: moved by 0.3 to 1.5 m, or not there. It is drawn as DXF in units of its own.
Its unit is known to 2 %. Compared is where the map's end points come
to lie with where they are; the map's own error is in it.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import ezdxf
import numpy as np

from floor_plans import Building, map_building
from gridslam.evaluation.trajectory import align
from gridslam.geometry import se2
from gridslam.plan import points_of_scans
from gridslam.plan.alignment import align_points, align_walls
from gridslam.plan.drawn_plans import read_drawn_plan
from gridslam.types import FloatArray
from measure import write_document

SEEDS = tuple(range(10))
WRONG = 0.1
TARGETS = {"position_m": 0.05, "heading_deg": 0.2}


def draw(building: Building, path: Path, rng: np.random.Generator, wrong: float) -> tuple[FloatArray, float]:
    """Draw a plan; the pose of the truth in it, m, and its units for each metre."""
    walls = building.log.walls.reshape(-1, 2, 2).copy()
    chosen = rng.permutation(len(walls))[: round(wrong * len(walls))]
    walls[chosen] += rng.choice([-1, 1], (len(chosen), 1, 2)) * rng.uniform(0.3, 1.5, (len(chosen), 1, 2))
    walls = np.delete(walls, chosen[: len(chosen) // 3], axis=0)
    pose = np.array([*rng.uniform(-20, 20, 2), rng.uniform(-np.pi, np.pi)])
    per_m = float(np.exp(rng.uniform(np.log(3.0), np.log(300.0))))
    ends = per_m * se2.transform_points(pose, walls.reshape(-1, 2))
    drawing = ezdxf.new()
    for begin, end in ends.reshape(-1, 2, 2).tolist():
        drawing.modelspace().add_line(begin, end)
    drawing.saveas(path)
    return pose, per_m


def score(building: Building, seed: int, wrong: float = WRONG) -> dict[str, float]:
    """Errors of the alignment."""
    rng = np.random.default_rng(seed)
    moved = points_of_scans(building.scans(building.poses), building.grid.resolution_m)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "plan.dxf"
        truth_in_plan, per_m = draw(building, path, rng, wrong)
        fixed, unit_m = read_drawn_plan(path, rng.uniform(0.98, 1.02) / per_m)
    true_pose = se2.compose(truth_in_plan, align(building.poses[:, :2], building.log.truth.poses[:, :2]))
    found = align_walls(moved, fixed, align_points(moved, fixed, True))
    length = unit_m * per_m
    off = found.transform(moved.positions) / length - se2.transform_points(true_pose, moved.positions)
    turn = (found.pose[2] - true_pose[2] + np.pi) % (2 * np.pi) - np.pi
    return {
        "position_m": float(np.hypot(*off.T).max()),
        "heading_deg": float(abs(np.rad2deg(turn))),
        "scale_error": float(found.scale / length - 1),
        "walls_in_common": found.share,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print and write the errors; gives 1 where a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seeds", nargs="*", type=int)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(arguments)
    rows: dict[int, Any] = {}
    for seed in given.seeds or SEEDS:
        rows[seed] = score(map_building("random", seed), seed)
        print(seed, rows[seed], flush=True)
    worst = {name: max(row[name] for row in rows.values()) for name in TARGETS}
    print(worst)
    if given.out is not None:
        how = f"python benchmarks/plan_alignment.py --out benchmarks/results/{given.out.name}"
        write_document(given.out, how, targets=TARGETS, worst=worst, rows=rows)
    return int(any(worst[name] > most for name, most in TARGETS.items()))


if __name__ == "__main__":
    raise SystemExit(main())
