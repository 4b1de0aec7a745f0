"""Compare two runs of the same logs: list changes for the worse beyond the noise of the seeds."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, final

from gridslam.batch.journal import read_rows
from gridslam.errors import InputError
from gridslam.evaluation.regression import LEAST_PAIRS, Change, find_changes

REGRESSION_SCHEMA: Final = "gridslam.regression/2"

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
_SCORES: Final = {
    "error_m": (("evaluation", "relations", "trans_mean_m"), ("evaluation", "ate", "trans_rmse_m")),
    "error_rad": (("evaluation", "relations", "rot_mean_deg"), ("evaluation", "ate", "rot_rmse_deg")),
    "worst_m": (("evaluation", "relations", "trans_max_m"), ("evaluation", "ate", "trans_max_m")),
    "sharpness_m": (("loop_closure", "sharpness_m"),),
}
"""Where `run.json` has each figure: of relations the means, of a true trajectory the root mean squares."""
_SEEDED = re.compile(r"(.+)-seed(\d+)")


@final
@dataclass(frozen=True)
class Regression:
    """Comparison of two runs.

    Attributes
    ----------
    old, new : str
        Their output folders.
    level : float
        Probability of any false alarm.
    pairs : int
        Runs that are in both.
    unpaired : dict of str to list of str
        Folders of runs that are in one alone, by "old" and "new".
    failed : dict of str to list of str
        Folders of runs that failed, of those that are in both.
    changes : list of Change
        Of each log and figure, and of all logs together.
    """

    old: str
    new: str
    level: float
    pairs: int
    unpaired: dict[str, list[str]]
    failed: dict[str, list[str]]
    changes: list[Change]

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
        sentences = {"worse": [*map(_describe, self.worse)], "better": [*map(_describe, self.better)]}
        return {"schema": REGRESSION_SCHEMA, **asdict(self), **sentences}

    def lines(self) -> list[str]:
        """Return the comparison in sentences: first the verdict."""
        worse = self.worse
        verdict = f"worse in {len(worse)} of {len(self.changes)} figures" if worse else "nothing is worse beyond noise"
        lines = [f"{verdict} ({self.pairs} pairs; at most {self.level:.0%} false alarms)"]
        lines += [f"worse: {_describe(change)} ({change.pairs} pairs, p = {change.p_worse:.2g})" for change in worse]
        lines += [
            f"better: {_describe(change)} ({change.pairs} pairs, p = {change.p_better:.2g})" for change in self.better
        ]
        old, new = (set(self.failed[name]) for name in ("old", "new"))
        lists = {"fails now": sorted(new - old), "fails no more": sorted(old - new)}
        lists |= {f"only in {name}": folders for name, folders in self.unpaired.items()}
        return lines + [f"{name}: {', '.join(folders)}" for name, folders in lists.items() if folders]


def compare_batches(
    old: str | Path,
    new: str | Path,
    *,
    level: float = 0.05,
    error_margin: float = 0.01,
    cost_margin: float = 0.1,
) -> Regression:
    """Compare two runs of the same logs.

    Runs are paired by the folders of their results. Folders whose names end in ``-seedN`` are seeds of one log.

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
        One of the folders has no journal, or there are fewer than `LEAST_PAIRS` pairs.
    """
    before, after = ({row["folder"]: row for row in read_rows(folder)} for folder in (old, new))
    differences: dict[tuple[str, str], list[float]] = defaultdict(list)
    failed: dict[str, list[str]] = {"old": [], "new": []}
    both = sorted(before.keys() & after.keys())
    unpaired = {"old": sorted(before.keys() - after.keys()), "new": sorted(after.keys() - before.keys())}
    for folder in both:
        seeded = _SEEDED.fullmatch(folder)
        pair = before[folder], after[folder]
        figures = [measure(row) for row in pair]
        for name in FIGURES:
            difference = _difference(name, *figures)
            differences[seeded[1] if seeded else folder, name].append(difference)
            differences[ALL_LOGS, name].append(difference)
        for name, row in zip(failed, pair, strict=True):
            failed[name] += [folder] if row["status"] == "failed" else []
    if len(both) < LEAST_PAIRS:
        raise InputError(
            new, f"expected at least {LEAST_PAIRS} runs that are in {old}, too, got {len(both)}: nothing could be found"
        )
    margins = {name: math.log1p(cost_margin if name in _COSTS else error_margin) for name in FIGURES} | {"failed": 0.0}
    return Regression(str(old), str(new), level, len(both), unpaired, failed, find_changes(differences, margins))


def measure(row: Mapping[str, Any]) -> dict[str, float]:
    """Return the figures of a row of the journal that it has, with costs: m, rad, s, bytes."""
    if row["status"] != "done":
        return {"failed": 1.0}
    found: dict[str, float | None] = {"failed": 0.0} | {name: row[name] for name in _COSTS}
    for name, paths in _SCORES.items():
        values = (_number(row["document"], path) for path in paths)
        found[name] = next((value for value in values if value is not None), None)
    if found["error_rad"] is not None:
        found["error_rad"] = math.radians(found["error_rad"])
    return {name: float(value) for name, value in found.items() if value is not None and math.isfinite(value)}


def _number(document: object, keys: Sequence[str]) -> float | None:
    for key in keys:
        document = document.get(key) if isinstance(document, Mapping) else None
    return document if isinstance(document, int | float) else None


def _difference(name: str, old: Mapping[str, float], new: Mapping[str, float]) -> float:
    """Return the logarithm of the ratio new / old, or the difference for failures; NaN where a value is missing."""
    if name == "failed":
        return new[name] - old[name]
    a, b = old.get(name, math.nan), new.get(name, math.nan)
    if a == b == 0:
        return 0.0
    return math.log(b / a) if a > 0 and b > 0 else math.nan


def _describe(change: Change) -> str:
    name = FIGURES[change.figure]
    if change.figure == "failed":
        return f"{change.log}: {name} {change.mean:+.0%} of the runs"
    return f"{change.log}: {name} {math.expm1(change.mean):+.1%}"
