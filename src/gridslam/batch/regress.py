"""Compare two runs of the same logs: list changes for the worse beyond the noise of the seeds."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from gridslam.batch.runs import Run, read_runs
from gridslam.errors import InputError
from gridslam.evaluation.regression import LEAST_PAIRS, Change, find_changes

REGRESSION_SCHEMA: Final = "gridslam.regression/1"

ALL_LOGS: Final = "all logs"
"""Name of the group of all pairs."""

FIGURES: Final = {
    "error_m": "error",
    "error_rad": "error of the heading",
    "cpu_s": "CPU time",
    "peak_memory_bytes": "memory",
    "failed": "failures",
}
"""Figures that are compared, and their labels."""

_COSTS = ("cpu_s", "peak_memory_bytes")
_SEEDED = re.compile(r"(.+)-seed(\d+)")


@final
@dataclass(frozen=True)
class Regression:
    """Comparison of two runs.

    Attributes
    ----------
    old, new : Path
        Their output folders.
    level : float
        Probability of any false alarm.
    changes : tuple of Change
        Of each log and figure, and of all logs together.
    pairs : int
        Runs that are in both.
    unpaired : dict of str to tuple of str
        Folders of runs that are in one alone, by "old" and "new".
    failed : dict of str to tuple of str
        Folders of runs that failed, of those that are in both.
    """

    old: Path
    new: Path
    level: float
    changes: tuple[Change, ...]
    pairs: int
    unpaired: dict[str, tuple[str, ...]]
    failed: dict[str, tuple[str, ...]]

    @property
    def worse(self) -> list[Change]:
        """Changes for the worse beyond noise and margin."""
        return [change for change in self.changes if change.p_worse <= self.level]

    @property
    def better(self) -> list[Change]:
        """Changes for the better beyond noise and margin."""
        return [change for change in self.changes if change.p_better <= self.level]

    def document(self) -> dict[str, Any]:
        """Return the comparison as JSON values."""
        return {
            "schema": REGRESSION_SCHEMA,
            "old": str(self.old),
            "new": str(self.new),
            "level": self.level,
            "pairs": self.pairs,
            "unpaired": self.unpaired,
            "failed": self.failed,
            "worse": [_describe(change) for change in self.worse],
            "better": [_describe(change) for change in self.better],
            "changes": [_describe(change) | asdict(change) for change in self.changes],
        }

    def lines(self) -> list[str]:
        """Return the comparison in sentences: first the verdict."""
        worse, better = self.worse, self.better
        verdict = f"worse in {len(worse)} of {len(self.changes)} figures" if worse else "nothing is worse beyond noise"
        lines = [f"{verdict} ({self.pairs} pairs; at most {self.level:.0%} false alarms)"]
        for name, changes, p in (("worse", worse, "p_worse"), ("better", better, "p_better")):
            for change in changes:
                lines.append(f"{name}: {_sentence(change)} ({change.pairs} pairs, p = {getattr(change, p):.2g})")
        old, new = (set(self.failed[name]) for name in ("old", "new"))
        lists = {"fails now": sorted(new - old), "fails no more": sorted(old - new)}
        lists |= {f"only in {name}": list(folders) for name, folders in self.unpaired.items()}
        lines += [f"{name}: {', '.join(folders)}" for name, folders in lists.items() if folders]
        return lines


def compare_batches(
    old: str | Path,
    new: str | Path,
    *,
    level: float = 0.05,
    error_margin: float = 0.01,
    cost_margin: float = 0.1,
) -> Regression:
    """Compare two runs of the same logs.

    Runs are paired by the folders of their results. Folders whose names end in ``-seedN`` are seeds of one log; those
    of a log that are left are paired in their order, so that runs with other seeds can be compared.

    Parameters
    ----------
    old, new : str or Path
        Output folders of `gridslam batch`.
    level : float, (0, 0.5]
        Probability of any false alarm, over all logs and figures (see `find_changes`).
    error_margin, cost_margin : float, at least 0
        Ratio by which errors, and CPU time or memory, may grow.

    Raises
    ------
    InputError
        One of the folders has no journal, or there are too few pairs for any change to be found.
    """
    before, after = (_by_group(read_runs(folder)) for folder in (old, new))
    differences: dict[str, dict[str, list[float]]] = {}
    failed: dict[str, list[str]] = {"old": [], "new": []}
    unpaired: dict[str, list[str]] = {"old": [], "new": []}
    count = 0
    for group in sorted({*before, *after}):
        pairs = _pair(before.get(group, {}), after.get(group, {}), unpaired)
        count += len(pairs)
        if pairs:
            differences[group] = {name: [_difference(name, *pair) for pair in pairs] for name in FIGURES}
        for pair in pairs:
            for name, run in zip(failed, pair, strict=True):
                failed[name] += [] if run.is_done else [run.row["folder"]]
    least = max(LEAST_PAIRS, math.floor(-math.log2(level)) + 1)
    if count < least:
        raise InputError(
            new, f"expected at least {least} runs that are in {old}, too, got {count}: nothing could be found"
        )
    margins = {name: math.log1p(cost_margin if name in _COSTS else error_margin) for name in FIGURES} | {"failed": 0.0}
    changes = find_changes(differences, np.random.default_rng(0), margins=margins, together=ALL_LOGS)
    return Regression(
        Path(old),
        Path(new),
        level,
        tuple(changes),
        count,
        {name: tuple(folders) for name, folders in unpaired.items()},
        {name: tuple(folders) for name, folders in failed.items()},
    )


def _by_group(runs: Iterable[Run]) -> dict[str, dict[str, Run]]:
    """Runs by log, and by folder."""
    groups: dict[str, dict[str, Run]] = {}
    for run in runs:
        folder = str(run.row["folder"])
        seeded = _SEEDED.fullmatch(folder)
        groups.setdefault(seeded[1] if seeded else folder, {})[folder] = run
    return groups


def _pair(old: Mapping[str, Run], new: Mapping[str, Run], unpaired: Mapping[str, list[str]]) -> list[tuple[Run, Run]]:
    both = [folder for folder in old if folder in new]
    left = [sorted(folder for folder in runs if folder not in both) for runs in (old, new)]
    count = min(map(len, left))
    for name, folders in zip(("old", "new"), left, strict=True):
        unpaired[name].extend(folders[count:])
    pairs = [(folder, folder) for folder in both] + list(zip(left[0][:count], left[1][:count], strict=True))
    return [(old[a], new[b]) for a, b in pairs]


def _difference(name: str, old: Run, new: Run) -> float:
    """Return the logarithm of the ratio new / old, or the difference for failures; NaN where a value is missing."""
    if name == "failed":
        return float(old.is_done) - float(new.is_done)
    a, b = (_figure(name, run) for run in (old, new))
    if a == b == 0:
        return 0.0
    return math.log(b / a) if a > 0 and b > 0 else math.nan


def _figure(name: str, run: Run) -> float:
    if not run.is_done:
        return math.nan
    value = run.row[name] if name in _COSTS else run.figures.get(name)
    return math.nan if value is None else float(value)


def _describe(change: Change) -> dict[str, Any]:
    return {"log": change.group, "figure": change.figure, "sentence": _sentence(change)}


def _sentence(change: Change) -> str:
    name = FIGURES[change.figure]
    if change.figure == "failed":
        return f"{change.group}: {name} {change.mean:+.0%} of the runs"
    return f"{change.group}: {name} {math.expm1(change.mean):+.1%}"
