"""Global localization where half of a building is mapped: is a robot outside that half found somewhere in it?

    python benchmarks/half_mapped.py [BUILDINGS] [--out FILE.json] [--inside]

50 buildings (random ones, rooms and the demo), two starts in each, anywhere on another drive: three minutes from there.
"found" counts scans at which the robot is not lost, "wrong" those of them that are off by more than 0.5 m; a start is
wrong if any scan is. --inside: with the certainty that the robot is inside, as if maps had no end; it must be worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from gridslam.geometry.se2 import between
from gridslam.localization import KnownMap, MonteCarloLocalization, place_verification
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate, vary_route
from measure import make_parser, write_document

NAMES = "random", "random", "rooms", "demo"
FIRST_SEED = 100  # lower ones chose the parameters
SCANS = 900
WRONG_M = 0.5
COUNTS = "inside", "outside", "found_inside", "found_outside", "wrong"


def half_mapped(name: str, seed: int) -> tuple[KnownMap, SimulatedLog]:
    """Half of a building, mapped with true poses on one side of a random line, and another drive all around it."""
    rng = np.random.default_rng(seed)
    world = make_world(name, np.random.default_rng(1000 + seed))
    first, second = (
        simulate(driven, RobotConfig(), OdometryNoise(), LidarConfig(), rng)
        for driven in (world, vary_route(world, rng))
    )
    angle = rng.uniform(0, 2 * np.pi)
    side = first.truth.poses[:, :2] @ [np.cos(angle), np.sin(angle)]
    mapper, last = OccupancyGridMapping(), np.full(3, 1e3)
    maps = mapper.empty(1)
    for k in np.flatnonzero(side <= np.median(side)):
        pose = first.truth.poses[k]
        if np.abs(between(last, pose)).max() > 0.1:
            mapper(maps, pose[None], first.measurements[k].scan.beams(0.05, 30.0))
            last = pose
    return KnownMap(maps.occupancy(0)), second


def localize_from(known: KnownMap, drive: SimulatedLog, start: int, seed: int) -> dict[str, int]:
    """Localize globally from a scan on; count scans inside and outside, those found there, and those found wrongly."""
    mcl, rng = MonteCarloLocalization(known), np.random.default_rng(seed)
    state = mcl.init()
    counts = dict.fromkeys(COUNTS, 0)
    for (odometry, scan), truth in zip(
        drive.measurements[start : start + SCANS], drive.truth.poses[start : start + SCANS], strict=True
    ):
        state, report = mcl.step(state, odometry, scan, rng)
        where = "inside" if known.is_free(truth[None])[0] else "outside"
        counts[where] += 1
        counts[f"found_{where}"] += not report.lost
        counts["wrong"] += bool(not report.lost and np.hypot(*(report.pose - truth)[:2]) > WRONG_M)
    return counts


def main(arguments: Sequence[str] | None = None) -> int:
    """Print and write the counts; gives 1 where a robot was found wrongly."""
    parser = make_parser(__doc__)
    parser.add_argument("buildings", nargs="?", type=int, default=50)
    parser.add_argument("--inside", action="store_true")
    given = parser.parse_args(arguments)
    if given.inside:
        place_verification._OUTSIDE_PRIOR = place_verification.CERTAINLY_INSIDE
        place_verification._OUTSIDE_LOG_ODDS = 0.0
    rows: list[dict[str, Any]] = []
    for seed in range(FIRST_SEED, FIRST_SEED + given.buildings):
        name = NAMES[seed % len(NAMES)]
        known, drive = half_mapped(name, seed)
        starts = np.random.default_rng(seed).integers(0, max(len(drive.measurements) - 400, 1), 2).tolist()
        for start in starts:
            rows.append({"building": name, "seed": seed, "start": start, **localize_from(known, drive, start, start)})
        print(rows[-2:], flush=True)
    inside, outside, found_inside, found_outside, wrong = (sum(row[key] for row in rows) for key in COUNTS)
    total = {
        "starts": len(rows),
        "wrong_starts": sum(row["wrong"] > 0 for row in rows),
        "wrong_of_found": wrong / max(found_inside + found_outside, 1),
        "found_of_inside": found_inside / inside,
        "found_of_outside": found_outside / max(outside, 1),
    }
    print(total)
    write_document(given.out, targets={"wrong_starts": 0}, total=total, rows=rows)
    return int(total["wrong_starts"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
