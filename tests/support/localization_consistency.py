"""Whether Monte Carlo localization knows how much it knows: covariances, and robots found where they are not.

Each run drives 30 m in a simulated building whose map is of another drive.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from aliasing_worlds import ALIASED
from gridslam.sim.worlds import DRAWN_WORLDS
from support.global_localization import INSIDE, Building, GlobalRun

WORLDS = ("random", "rooms", "bare_corridors", "hall", "demo")
"""Buildings in which covariances are measured; demo is an office."""

ALIKE = {"campus": 40, "bare_corridors": 20, "equal_rooms": 20, "symmetric": 20}
"""A hundred starts in buildings with equal corridors and rooms; campus is 2 km of corridors."""


_BUILDINGS = 4


def buildings(name: str, seeds: Sequence[int], *, backs_out: bool = False) -> Iterator[tuple[Building, int]]:
    """A building for each seed: one of four where they are drawn by chance, always the same otherwise."""
    count = min(_BUILDINGS, len(seeds)) if name in {**DRAWN_WORLDS, **ALIASED} else 1
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
