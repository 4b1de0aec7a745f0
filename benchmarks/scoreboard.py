"""The scoreboard, from a run of the public suite, as a file to be committed.

    python benchmarks/scoreboard.py suite.csv --manifest [--data FOLDER]
    gridslam batch suite.csv -o OUT --workers 1
    python benchmarks/scoreboard.py OUT [--data FOLDER] [--beside benchmarks/results/COMMIT.json] [-o FILE]

`python benchmarks/readme.py` then writes it into the README and docs/scoreboard.md.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

from gridslam.batch.journal import read_rows
from gridslam.batch.regress import measure
from measure import RESULTS, document

LOGS = {name: f"{name}.relations" for name in ("intel", "aces", "mit-csail")}
"""Public logs, each with its file of relations in the same folder."""

VARIANTS = {name: {"preset": name} for name in ("default", "gmapping")}
VARIANTS["filter"] = {"no-loop-closure": "true"}
"""Options of `gridslam map` of each way in which a log is mapped."""

FIGURES = {"error_m": 6, "error_rad": 7, "worst_m": 6, "sharpness_m": 5, "cpu_s": 2, "peak_memory_bytes": 0}
"""Figures of a run, and the decimals that are kept."""

_ERRORS = "error_m", "error_rad"


def main(arguments: Sequence[str] | None = None) -> Path:
    """Collect, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="The scoreboard, with the commit and the machine.")
    parser.add_argument(
        "batch", type=Path, metavar="OUT", help="output folder of gridslam batch, or the manifest to write"
    )
    parser.add_argument("--manifest", action="store_true", help="write what gridslam batch is to run")
    parser.add_argument("--data", type=Path, default=RESULTS.parents[2] / "shared" / "data", help="folder of logs")
    parser.add_argument("--beside", type=Path, help="an earlier file, with whose errors these are compared")
    parser.add_argument("--commit", help="commit that was run, if it is not the present one")
    parser.add_argument("-o", "--out", type=Path, default=RESULTS / "suite.json")
    given = parser.parse_args(arguments)
    if given.manifest:
        return write_manifest(given.batch, given.data)
    runs = [_describe(row) for row in read_rows(given.batch)]
    cells = collect(runs)
    found = document(
        "gridslam batch suite.csv --workers 1; CPU time of the children, with Python's start",
        cells=cells,
        runs=runs,
    )
    found["commit"] = given.commit or found["commit"]
    if given.beside:
        earlier = json.loads(given.beside.read_text(encoding="utf-8"))
        found["ratio"] = {"to": earlier["commit"], "logs": ratios(cells, earlier)}
    given.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    path: Path = given.out
    return path


def write_manifest(path: Path, data: Path, seeds: int = 10) -> Path:
    """Write what `gridslam batch` is to run: the logs that there are, by each variant with each seed."""
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.DictWriter(file, ["log", "name", "reference", "seed", "preset", "no-loop-closure"])
        rows.writeheader()
        for seed in range(seeds):
            for log, relations in LOGS.items():
                row = {"log": (data / f"{log}.clf.bz2").absolute(), "seed": seed}
                if (data / relations).is_file():
                    row["reference"] = (data / relations).absolute()
                for variant, options in VARIANTS.items():
                    rows.writerow(row | options | {"name": f"{log}-{variant}-seed{seed}"})
    return path


def collect(runs: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Of each log and variant the figures over its seeds: mean, 95 % interval of the mean, and worst."""
    cells: dict[str, dict[str, dict[str, Any]]] = {}
    for log, variant in dict.fromkeys((run["log"], run["variant"]) for run in runs):
        own = [run for run in runs if (run["log"], run["variant"]) == (log, variant)]
        columns = {name: [run[name] for run in own if run.get(name) is not None] for name in FIGURES}
        cell: dict[str, Any] = {"seeds": len(own), "failed": sum(run["failed"] for run in own)}
        cell |= {name: interval(values, FIGURES[name]) for name, values in columns.items() if values}
        cells.setdefault(log, {})[variant] = cell
    return cells


def interval(values: Sequence[float], decimals: int) -> dict[str, float]:
    """Mean, its 95 % interval by Student's t, and the largest."""
    mean = float(np.mean(values))
    half = 0.0
    if len(values) > 1:
        half = float(student.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values)))
    found = {"mean": mean, "low": max(mean - half, 0.0), "high": mean + half, "worst": max(values)}
    return {name: round(value, decimals) for name, value in found.items()}


def ratios(cells: Mapping[str, Any], earlier: Mapping[str, Any]) -> dict[str, dict[str, dict[str, float]]]:
    """Mean errors divided by those of an earlier scoreboard; costs are compared by `speed.py`, on one machine."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for log, variants in cells.items():
        for variant, cell in variants.items():
            before = earlier["cells"].get(log, {}).get(variant, {})
            means = {name: before[name]["mean"] for name in _ERRORS if name in before}
            told = {name: round(cell[name]["mean"] / mean, 3) for name, mean in means.items() if name in cell}
            if told:
                found.setdefault(log, {})[variant] = told
    return found


def _describe(row: Mapping[str, Any]) -> dict[str, Any]:
    name, _, seed = row["folder"].rpartition("-seed")
    log, _, variant = name.rpartition("-")
    figures = measure(row)
    found = {"log": log, "variant": variant, "seed": int(seed), "failed": row["status"] == "failed"}
    return found | {name: round(figures[name], decimals) for name, decimals in FIGURES.items() if name in figures}


if __name__ == "__main__":
    print(main())
