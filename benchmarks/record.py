"""Record the figures that the README shows: Intel and ACES, with loop closure and without, as a file to be committed.

python benchmarks/record.py [--data ../shared/data] [--seeds 3] [--beside benchmarks/results/COMMIT.json] [-o FILE]

`python benchmarks/readme.py` then writes them into the README. Five minutes on two cores that do nothing else.
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gridslam.evaluation import relation_errors
from gridslam.io.trajectories import read_relations
from measure import MapRun, document, map_timed

__all__ = ["RESULTS", "main", "ratios", "summary"]

RESULTS = Path(__file__).resolve().parent / "results"
_ROOT = RESULTS.parents[1]
_LOGS = "intel", "aces"
_VARIANTS = {"gridslam": (), "filter": ("--no-loop-closure",)}
_COMPARED = "translation_m", "rotation_deg", "cpu_s", "yardsticks", "peak_mb"


def main(arguments: Sequence[str] | None = None) -> Path:
    """Measure, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="Figures of the README, with the commit and the machine.")
    parser.add_argument("--data", type=Path, default=_ROOT.parent / "shared" / "data", help="folder of real logs")
    parser.add_argument("--seeds", type=int, default=3, help="seeds 0, 1, ... of each log [3]")
    parser.add_argument("--beside", type=Path, help="an earlier file, to which the ratios are told")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS / "present.json")
    given = parser.parse_args(arguments)
    logs = {log: _measured(given.data / log, range(given.seeds)) for log in _LOGS}
    how = "gridslam map LOG --seed SEED [--no-loop-closure], 30 particles; CPU time and memory are seed 0's"
    found = document(how, logs=logs)
    if given.beside:
        earlier = json.loads(given.beside.read_text(encoding="utf-8"))
        found["ratio"] = {"to": earlier["commit"], "logs": ratios(logs, earlier["logs"])}
    given.out.parent.mkdir(parents=True, exist_ok=True)
    given.out.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    path: Path = given.out
    return path


def _measured(log: Path, seeds: Sequence[int]) -> dict[str, Any]:
    relations = read_relations(log.with_suffix(".relations"))
    found = {}
    for name, options in _VARIANTS.items():
        runs = [map_timed(log.with_suffix(".clf.bz2"), "--seed", seed, *options) for seed in seeds]
        errors = [relation_errors(run.trajectory, relations) for run in runs]
        columns = {
            "translation_m": [error.trans_mean_m for error in errors],
            "rotation_deg": [error.rot_mean_deg for error in errors],
            "worst_relation_m": [error.trans_max_m for error in errors],
        }
        found[name] = summary(columns, runs[0])
    return found


def summary(columns: dict[str, list[float]], first: MapRun) -> dict[str, Any]:
    """Mean and worst over the seeds of each column, and the cost of the first run."""
    errors = {
        name: {"mean": round(statistics.fmean(values), 6), "worst": round(max(values), 6)}
        for name, values in columns.items()
    }
    cost = {"cpu_s": first.cost.cpu_s, "yardsticks": first.cost.yardsticks, "peak_mb": first.peak_mb}
    seeds = len(next(iter(columns.values())))
    return {"seeds": seeds, **errors, **{name: round(value, 2) for name, value in cost.items()}}


def ratios(present: dict[str, Any], earlier: dict[str, Any]) -> dict[str, Any]:
    """What both files tell, the present one's divided by the earlier one's; of errors the means'."""
    found: dict[str, Any] = {}
    for log, variants in present.items():
        for variant, figures in variants.items():
            before = earlier.get(log, {}).get(variant, {})
            told = {name: _mean(figures[name]) / _mean(before[name]) for name in _COMPARED if name in before}
            found.setdefault(log, {})[variant] = {name: round(value, 3) for name, value in told.items()}
    return found


def _mean(figure: float | dict[str, float]) -> float:
    return figure["mean"] if isinstance(figure, dict) else figure


if __name__ == "__main__":
    print(main())
