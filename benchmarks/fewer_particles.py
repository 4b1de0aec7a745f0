"""How few particles do, fixed or adapted: the whole command, and the filter alone, at equal seeds.

    python benchmarks/fewer_particles.py [--seeds 5] [--log NAME ...] [--number 30 --number kld] [--out FILE]
    python benchmarks/fewer_particles.py --simulated --seeds 10 [--number 30 --number kld] [--out FILE]

Simulated are the worlds of `closures.py`, with what is closed falsely, and those of `covariances.py`, with the NEES.
The error of a log is the mean translation error of the relations where there are any, on sparse logs the root mean
square distance from GMapping's path; of the others there is the cost alone. Rows of earlier runs stay where they are
not measured again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from closure_worlds import DECEPTIVE, campus, deceptive
from closures import judge_closures
from covariances import WORLDS, judge
from gridslam import Trajectory
from gridslam.config import Configuration, override
from gridslam.evaluation import absolute_errors, relation_errors
from gridslam.io.trajectories import read_relations, read_tum
from logs import Log, find
from measure import RESULTS, map_timed, write_document

__all__ = ["main"]

_NUMBERS = ("8", "30", "kld")
_MODES = {"alone": ("--no-loop-closure",), "full": ()}
_FIRST_SEED = 101  # that of covariances.py: its parameters were set on earlier ones
_HOW = (
    "gridslam map, seeds from 0 on, of simulated covariances from 101 on; errors in m, user and system seconds, "
    "particles on average over the key scans"
)


def main(arguments: Sequence[str] | None = None) -> Path:
    """Measure, print, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="Errors and costs by the number of particles.")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--log", action="append", help="name of a log; may be given several times [all]")
    parser.add_argument("--number", action="append", help="of particles, or kld [8, 30 and kld]")
    parser.add_argument("--simulated", action="store_true", help="worlds whose truth is known, and no logs")
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    parser.add_argument("--out", type=Path, default=RESULTS / "fewer_particles.json")
    given = parser.parse_args(arguments)
    path: Path = given.out
    document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"rows": []}
    rows: list[dict[str, Any]] = document["rows"]
    simulated: list[dict[str, Any]] = document.get("simulated", [])
    if given.simulated:
        for number in given.number or _NUMBERS:
            found = _measure_simulated(number, given.seeds)
            simulated = [*(old for old in simulated if old["number"] != number), found]
            write_document(path, _HOW, rows=rows, simulated=simulated)
        return path
    logs = [*find(given.data), *find(given.data / "sparse"), *find(given.data / "loops")]
    for log in logs:
        if given.log and log.name not in given.log:
            continue
        for mode, options in _MODES.items():
            for number in given.number or _NUMBERS:
                row = {"log": log.name, "mode": mode, "number": number} | _measure(log, number, options, given.seeds)
                rows = [old for old in rows if [*old.values()][:3] != [log.name, mode, number]] + [row]
                print({name: value for name, value in row.items() if name != "cpu_s"}, flush=True)
                write_document(path, _HOW, rows=rows, simulated=simulated)
    return path


def _assignment(number: str) -> str:
    """The parameter that asks for this number of particles."""
    return "particle_number.kind=KldNumber" if number == "kld" else f"particles={number}"


def _measure_simulated(number: str, seeds: int) -> dict[str, Any]:
    """What is found in worlds whose truth is known."""
    configuration = override(Configuration(), _assignment(number))
    return {
        "number": number,
        "seeds": seeds,
        "closures": {kind: _measure_closures(kind, seeds, configuration) for kind in (*DECEPTIVE, "campus")},
        "covariances": {kind: _measure_covariances(kind, seeds, configuration) for kind in WORLDS},
    }


def _measure_closures(kind: str, seeds: int, configuration: Configuration) -> dict[str, list[float]]:
    """What is closed, rightly and falsely, and errors, of each drive in a kind of world."""
    drives = [campus(seed) if kind == "campus" else deceptive(kind, seed) for seed in range(seeds)]
    runs = [judge_closures(drive, configuration) for drive in drives]
    found = {name: [round(getattr(run, name), 5) for run in runs] for name in runs[0]._fields if name != "cpu_s"}
    print(kind, found, flush=True)
    return found


def _measure_covariances(kind: str, seeds: int, configuration: Configuration) -> dict[str, float]:
    """Means of the NEES, and of what else is judged, over drives in a kind of world."""
    drives = [judge(kind, seed, configuration) for seed in range(_FIRST_SEED, _FIRST_SEED + seeds)]
    names = [name for name in drives[0] if name not in ("kind", "seed")]
    found = {name: round(float(np.mean([drive[name] for drive in drives if name in drive])), 4) for name in names}
    print(kind, found, flush=True)
    return found


def _measure(log: Log, number: str, options: Sequence[str], seeds: int) -> dict[str, Any]:
    """Errors, costs and numbers of particles, one for each seed."""
    runs = [map_timed(log.path, "--set", _assignment(number), *options, "--seed", seed) for seed in range(seeds)]
    errors = [_error(log, run.trajectory) for run in runs]
    return {
        "errors_m": [round(error, 5) for error in errors if error is not None],
        "cpu_s": [round(run.cost.cpu_s, 2) for run in runs],
        "cpu_mean_s": round(float(np.mean([run.cost.cpu_s for run in runs])), 2),
        "particles_mean": [round(run.document["filter"]["particles_mean"], 2) for run in runs],
        "resamplings": [run.document["filter"]["resamplings"] for run in runs],
        "peak_mb": round(max(run.peak_mb for run in runs), 1),
    }


def _error(log: Log, trajectory: Trajectory) -> float | None:
    """What is known of the error of a trajectory."""
    if log.relations is not None:
        return relation_errors(trajectory, read_relations(log.relations)).trans_mean_m
    reference = log.path.with_name(f"{log.name}.ref.tum.gz")
    if not reference.exists():
        return None
    return absolute_errors(trajectory, read_tum(reference)).trans_rmse_m


if __name__ == "__main__":
    print(main())
