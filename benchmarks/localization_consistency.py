"""Whether Monte Carlo localization knows how much it knows: covariances, and robots found where they are not.

python benchmarks/localization_consistency.py [--first 100] [--runs 20] [--part covariances|odometry|ekf] [-o FILE]

Each run drives 30 m in a simulated building whose map is of another drive. The covariances take a quarter of an hour on
one core; odometry that counts reverse motion as forward, and EKF localization, two minutes each.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from global_localization import INSIDE, ORDINARY, Building, GlobalRun
from gridslam.localization.monte_carlo import MonteCarloConfiguration
from gridslam.sim.worlds import DRAWN_WORLDS
from landmark_drives import describe_ekf
from measure import RESULTS, write_document

__all__ = ["ALIKE", "WORLDS", "buildings", "describe_covariances", "describe_finds", "main"]

WORLDS = ("random", "rooms", "bare_corridors", "hall", "demo")
"""Buildings in which covariances are measured; demo is an office."""

ALIKE = {"campus": 40, "bare_corridors": 20, "equal_rooms": 20, "symmetric": 20}
"""A hundred starts in buildings with equal corridors and rooms; campus is 2 km of corridors."""

PARTS = ("covariances", "odometry", "ekf")

_BUILDINGS = 4
_ODOMETRY_WAY_M = 60.0


def main(arguments: Sequence[str] | None = None) -> Path:
    """Measure, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="Consistency of Monte Carlo localization in simulated buildings.")
    parser.add_argument(
        "--first", type=int, default=100, help="first seed; parameters were chosen with those below 100"
    )
    parser.add_argument("--runs", type=int, default=20, help="runs in each building")
    parser.add_argument("--part", choices=PARTS, default="covariances")
    parser.add_argument("--data", type=Path, default=RESULTS.parents[2] / "shared" / "data", help="real logs")
    parser.add_argument("-o", "--out", type=Path, help="results/localization.json, or localization_PART.json")
    given = parser.parse_args(arguments)
    seeds = range(given.first, given.first + given.runs)
    suffix = "" if given.part == "covariances" else f"_{given.part}"
    out: Path = given.out or RESULTS / f"localization{suffix}.json"
    how = f"seeds {seeds.start} to {seeds.stop - 1}"
    if given.part == "ekf":
        write_document(out, f"EKF localization, {how}, and MRCLAM 6", drives=describe_ekf(given.data, seeds))
    elif given.part == "odometry":
        how = f"odometry that counts reverse motion as forward, 60 m, {how}"
        write_document(out, how, buildings=describe_odometry(seeds))
    else:
        _write_covariances(out, given.first, given.runs)
    return out


def _write_covariances(out: Path, first: int, count_of_runs: int) -> None:
    seeds = range(first, first + count_of_runs)
    covariances: dict[str, Any] = {}
    for name in WORLDS:
        pairs = list(buildings(name, seeds))
        covariances[name] = {
            "tracked": describe_covariances([building.track(seed) for building, seed in pairs]),
            "found": describe_covariances([building.localize_globally(seed) for building, seed in pairs]),
        }
        print(name, covariances[name], flush=True)
    finds: dict[str, Any] = {}
    for name in (*ALIKE, *ORDINARY):
        some = range(first, first + ALIKE.get(name, count_of_runs // 2))
        finds[name] = describe_finds([building.localize_globally(seed) for building, seed in buildings(name, some)])
        print(name, finds[name], flush=True)
    how = f"30 m of simulated drives, seeds {seeds.start} to {seeds.stop - 1}; the map is of another drive"
    write_document(out, how, covariances=covariances, finds=finds)


def describe_odometry(seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """How many robots that leave dead ends backward are lost, by odometry that does not know it, and by healthy one."""
    found: dict[str, dict[str, float]] = {}
    unchecked = MonteCarloConfiguration(odometry_check=None)
    for name in ("demo", "hall", "random"):
        healthy = list(buildings(name, seeds, backs_out=True))
        faulty = [(building.with_fault("unsigned_odometry"), seed) for building, seed in healthy]
        for label, pairs, parts in (
            ("healthy", healthy, MonteCarloConfiguration()),
            ("healthy, not checked", healthy, unchecked),
            ("unsigned", faulty, MonteCarloConfiguration()),
            ("unsigned, not checked", faulty, unchecked),
        ):
            begin = time.process_time()
            runs = GlobalRun.joined([building.track(seed, _ODOMETRY_WAY_M, parts) for building, seed in pairs])
            cost = time.process_time() - begin
            scans = len(runs.lost)
            known = runs.nees[~runs.lost]
            found[f"{name}, {label}"] = {
                "scans": scans,
                "lost": int(runs.lost.sum()),
                "false": int((runs.wrong & ~runs.lost).sum()),
                "nees": round(float(known.mean()), 3),
                "inside": round(float((known < INSIDE).mean()), 4),
                "ms_per_scan": round(1e3 * cost / scans, 2),
            }
            print(name, label, found[f"{name}, {label}"], flush=True)
    return found


def buildings(name: str, seeds: Sequence[int], *, backs_out: bool = False) -> Iterator[tuple[Building, int]]:
    """A building for each seed: one of four where they are drawn by chance, always the same otherwise."""
    count = min(_BUILDINGS, len(seeds)) if name in DRAWN_WORLDS else 1
    drawn = [Building.of(name, seeds[k], backs_out=backs_out) for k in range(count)]
    yield from ((drawn[k % count], seed) for k, seed in enumerate(seeds))


def describe_covariances(runs: Sequence[GlobalRun]) -> dict[str, float]:
    """NEES and the ratio inside the 95 % ellipsoid, of all scans and of the last ones, where the robot was not lost."""
    online = np.concatenate([run.nees[~run.lost] for run in runs])
    last = np.array([run.nees[-1] for run in runs if not run.lost[-1]])
    found: dict[str, float] = {"scans": len(online)}
    for name, values in (("online", online), ("final", last)):
        if len(values):
            found |= {f"nees_{name}": round(float(values.mean()), 3)}
            found |= {f"inside_{name}": round(float((values < INSIDE).mean()), 4)}
    return found


def describe_finds(runs: Sequence[GlobalRun]) -> dict[str, float | None]:
    """How many robots were found where they are not, and how soon the others."""
    both = GlobalRun.joined(list(runs))
    right = [run.found_after_m for run in runs if not (run.wrong & ~run.lost).any()]
    return {
        "starts": len(runs),
        "false_starts": sum(bool((run.wrong & ~run.lost).any()) for run in runs),
        "false_scans": int((both.wrong & ~both.lost).sum()),
        "scans": len(both.lost),
        "localized": round(float((~both.lost).mean()), 4),
        "never_found": int(np.isinf(right).sum()),
        "median_found_after_m": round(float(np.median(right)), 2) if np.isfinite(np.median(right)) else None,
    }


if __name__ == "__main__":
    print(main())
