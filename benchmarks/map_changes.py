"""Is furniture found that was moved between two days? Simulated buildings, one to five pieces moved.

    python benchmarks/map_changes.py [SEED ...] [--out FILE]

Both days are driven and mapped by themselves, the second one from the other end of the route, so that its map has
another frame; the maps are aligned by their walls. Compared are areas: where a piece stood on one day, of which a
quarter of the outline was seen that day, and which was seen to be free on the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from floor_plan_truth import CELL_M, Seen, look, read_truth
from floor_plans import Building, drive
from gridslam.config import Configuration
from gridslam.evaluation.trajectory import align
from gridslam.geometry import se2
from gridslam.plan import points_of_scans
from gridslam.plan.alignment import align_points
from gridslam.plan.changes import Changes, find_changes
from gridslam.sim import World, make_world
from gridslam.sim.floor_plan import clearance
from gridslam.types import FloatArray
from measure import make_parser, write_document

SEEDS = tuple(range(8))
LANE_M = 0.6
APART_M = 0.3
NEAR_M = 0.1
TARGETS = {"precision": 0.95, "recall": 0.90}


def move_furniture(world: World, rng: np.random.Generator) -> tuple[World, FloatArray, FloatArray]:
    """Move one to five pieces within their rooms; the world after, and the outlines (M, 4, 2) before and after."""
    truth = read_truth(world.walls)
    boxes = truth.furniture.reshape(-1, 4, 2, 2)[:, :, 0]
    route = np.concatenate([np.linspace(a, b, 20) for a, b in zip(world.route, world.route[1:], strict=False)])
    wanted = int(rng.integers(1, 6))
    walls = world.walls.copy()
    moved = []
    for box in rng.permutation(boxes):
        middle = box.mean(axis=0)
        own = np.flatnonzero([any(np.allclose(wall[:2], corner) for corner in box) for wall in walls])
        others = np.delete(walls, own, axis=0)
        for _ in range(60):
            place = middle + rng.uniform(-2.5, 2.5, 2)
            turned = se2.transform_points([*place, rng.uniform(0, np.pi)], box - middle)
            sides = np.concatenate([turned, np.roll(turned, -1, axis=0)], axis=1)
            way = np.linspace(middle, place, 30)
            edges = np.concatenate([np.linspace(side[:2], side[2:], 10) for side in sides])
            if (
                np.hypot(*(place - middle)) > 1.5
                and clearance(sides, route).min() > LANE_M
                and clearance(others, np.concatenate([edges, way])).min() > APART_M
            ):
                walls[own] = sides
                moved.append((box, turned))
                break
        if len(moved) == wanted:
            break
    before, after = (np.array(outlines) for outlines in zip(*moved, strict=True))
    return replace(world, walls=walls), before, after


def compare(days: Sequence[Building], worse: str = "") -> Changes:
    """Align the second day's map with the first one's, and find what has changed; `worse` shifts it by 20 cm."""
    points = [points_of_scans(day.scans(day.poses), day.grid.resolution_m) for day in days]
    alignment = align_points(points[1], points[0])
    if worse == "shifted":
        alignment = alignment._replace(pose=alignment.pose + np.array([0.2, 0.2, 0.0]))
    return find_changes(days[0].grid, days[1].grid, alignment)


def score(days: Sequence[Building], outlines: Sequence[FloatArray], changes: Changes) -> dict[str, Any]:
    """Areas, m2: due and found of them; found and right of them."""
    seen = [_see(day) for day in days]
    raster = seen[0].raster
    pose = align(days[0].poses[:, :2], days[0].log.truth.poses[:, :2])
    figures = {"pieces": len(outlines[0]), "due_m2": 0.0, "found_of_due_m2": 0.0, "found_m2": 0.0, "right_m2": 0.0}
    for kind, here, there in (("gone", 0, 1), ("new", 1, 0)):
        own = [change.cells for change in changes.changes if change.kind == kind]
        found = se2.transform_points(pose, np.concatenate([np.zeros((0, 2)), *own]))
        edges = np.concatenate([_walk(outline) for outline in outlines[here]])
        was_seen = cKDTree(seen[here].ends).query(edges)[0] < 0.05
        due = edges[was_seen & seen[there].free[raster.cells(edges)]]
        figures["due_m2"] += len(due) * CELL_M**2
        figures["found_m2"] += len(found) * CELL_M**2
        if len(found):
            figures["found_of_due_m2"] += int((cKDTree(found).query(due)[0] < NEAR_M).sum()) * CELL_M**2
            figures["right_m2"] += int((cKDTree(edges).query(found)[0] < NEAR_M).sum()) * CELL_M**2
    return figures


def _walk(outline: FloatArray) -> FloatArray:
    """Places along an outline, a cell apart."""
    ends = np.roll(outline, -1, axis=0)
    steps = (np.hypot(*(ends - outline).T) / CELL_M).astype(int)
    return np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in zip(outline, ends, steps, strict=True)])


@cache
def _see(day: Building) -> Seen:
    """What was seen of the truth that day."""
    origins, ends = zip(*day.scans(day.log.truth.poses), strict=True)
    return look(read_truth(day.log.walls), np.array(origins), list(ends))


def make_days(seed: int, config: Configuration | None = None) -> tuple[list[Building], list[FloatArray]]:
    """Two days in a building, and the outlines of what was moved, on the first and on the second."""
    rng = np.random.default_rng(1000 + seed)
    world = make_world("random", np.random.default_rng(seed))
    later, before, after = move_furniture(world, rng)
    later = replace(later, route=later.route[::-1].copy())
    days = (world, seed), (later, seed + 500)
    return [drive(day, k, np.random.default_rng(k), config) for day, k in days], [before, after]


def summarize(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Precision and recall by area, over all pairs of days."""
    total = {name: sum(row[name] for row in rows) for name in rows[0]}
    return {
        "precision": total["right_m2"] / max(total["found_m2"], 1e-9),
        "recall": total["found_of_due_m2"] / max(total["due_m2"], 1e-9),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print and write the figures; gives 1 where a target is missed."""
    parser = make_parser(__doc__)
    parser.add_argument("seeds", nargs="*", type=int)
    given = parser.parse_args(arguments)
    rows: dict[str, list[dict[str, Any]]] = {"": [], "shifted": []}
    for seed in given.seeds or SEEDS:
        days, outlines = make_days(seed)
        for worse, own in rows.items():
            own.append(score(days, outlines, compare(days, worse)))
        print(seed, rows[""][-1], flush=True)
    summaries = {worse or "as found": summarize(own) for worse, own in rows.items()}
    print(summaries)
    write_document(given.out, targets=TARGETS, summaries=summaries, rows=rows[""])
    return int(any(summaries["as found"][name] < least for name, least in TARGETS.items()))


if __name__ == "__main__":
    raise SystemExit(main())
