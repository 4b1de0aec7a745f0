"""Check the model of cost on runs of gridslam map: python benchmarks/costs.py OUT ... [-o FILE].

Each OUT is the output folder of a run, or a folder of such folders. The kind of a log, all of whose runs are held back
together, is its name up to the first hyphen: worlds of the simulation, or single real logs.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.evaluation.cost import FEATURES, Cost, Work, check_costs, fit_costs
from gridslam.io.text import read_json
from measure import write_document

__all__ = ["main"]

_RESULT = Path(__file__).resolve().parent / "results" / "costs.json"


def main(arguments: Sequence[str] | None = None) -> Path:
    """Fit, check, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="The model of cost, checked on logs that were held back.")
    parser.add_argument("folders", type=Path, nargs="+", metavar="OUT", help="folders of runs")
    parser.add_argument("-o", "--out", type=Path, default=_RESULT)
    given = parser.parse_args(arguments)
    runs = [_describe(path) for folder in given.folders for path in sorted(folder.rglob("run.json"))]
    work = [Work(run["scans"], run["key_scans"], run["particles"], run["area_m2"]) for run in runs]
    costs = [Cost(run["cpu_s"], run["peak_memory_bytes"]) for run in runs]
    model = fit_costs(work, costs)
    errors = check_costs(work, costs, [run["kind"] for run in runs])
    checked = {
        name: {
            "median": round(float(np.median(np.abs(error))), 3),
            "within_30_percent": round(float(np.mean(np.abs(error) <= 0.3)), 3),
            "worst": round(float(np.abs(error).max()), 3),
        }
        for name, error in zip(("cpu_s", "memory_bytes"), errors, strict=True)
    }
    write_document(
        given.out,
        "gridslam map, one core beside other work; errors of kinds that were held back",
        held_back=checked,
        model={"features": FEATURES, "cpu_s": model.cpu_s, "memory_bytes": model.memory_bytes},
        runs=runs,
    )
    path: Path = given.out
    return path


def _describe(path: Path) -> dict[str, Any]:
    document = read_json(path)
    found = document["filter"]
    log = Path(document["input"]["path"]).name.partition(".")[0]
    return {
        "log": log,
        "kind": log.partition("-")[0],
        "scans": document["scans"]["read"],
        "key_scans": document["scans"]["used"],
        "particles": found["particles"],
        "area_m2": round(found["map_width_m"] * found["map_height_m"], 1),
        "cpu_s": round(document["time"]["cpu_s"], 2),
        "peak_memory_bytes": document["peak_memory_bytes"],
    }


if __name__ == "__main__":
    print(main())
