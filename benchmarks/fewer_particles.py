"""How few particles do: python benchmarks/fewer_particles.py [--seeds 3]; the whole command on logs with relations."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from gridslam.evaluation import relation_errors
from gridslam.io.trajectories import read_relations
from logs import find
from measure import RESULTS, map_timed, write_document

__all__ = ["main"]

_COUNTS = (4, 8, 30)


def main(arguments: Sequence[str] | None = None) -> Path:
    """Measure, print, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="Errors of relations by the number of particles.")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--data", type=Path, default=Path(__file__).resolve().parents[2] / "shared" / "data")
    given = parser.parse_args(arguments)
    path = RESULTS / "fewer_particles.json"
    rows = []
    for log in find(given.data):
        if log.relations is None:
            continue
        relations = read_relations(log.relations)
        for count in _COUNTS:
            runs = [map_timed(log.path, "--particles", count, "--seed", seed) for seed in range(given.seeds)]
            errors = [relation_errors(run.trajectory, relations).trans_mean_m for run in runs]
            cpu_s = [round(run.cost.cpu_s, 2) for run in runs]
            rows.append(
                {"log": log.name, "particles": count, "errors_m": [round(e, 5) for e in errors], "cpu_s": cpu_s}
            )
            print(rows[-1], flush=True)
            write_document(path, "gridslam map, seeds from 0 on; mean translation error of the relations", rows=rows)
    return path


if __name__ == "__main__":
    print(main())
