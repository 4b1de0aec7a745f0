"""How well logs are mapped whose scans are far apart: python benchmarks/far_apart.py DATA [--seeds N] [--out FILE].

Logs of key scans only beside GMapping's path, which is good to about 5 cm; logs at full rate thinned by way or by
number beside their own result at full rate. Errors are the root mean square of the position after alignment.
"""

from __future__ import annotations

import gzip
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gridslam import CarmenLog, LogOptions, Trajectory, map_log
from gridslam.evaluation import absolute_errors
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray
from measure import RESULTS, make_parser, write_document
from report import table
from simulated import thin

SPARSE = ("acapulco", "belgioioso", "seattle", "freiburg-101")
"""Logs of key scans."""

FULL_RATE = ("intel", "aces", "mit-csail")
EVERY = (2, 5, 10)


class Case(NamedTuple):
    """A log, how it is read, and the poses (N, 3) of its scans."""

    name: str
    log: Path
    every: int
    reference: FloatArray


def off_from(poses: FloatArray, reference: FloatArray) -> float:
    """Root mean square of the position's error (m) of poses (N, 3) against a reference (N, 3), best aligned."""
    stamps = np.arange(len(reference)) * 10**9
    trajectories = Trajectory(stamps, poses), Trajectory(stamps, reference)
    return absolute_errors(*trajectories).trans_rmse_m


def gmapping_path(data: Path, name: str) -> FloatArray:
    """What GMapping made of a sparse log, (N, 3); good to about 5 cm."""
    with gzip.open(data / "sparse" / f"{name}.ref.tum.gz", "rt") as file:
        rows = np.loadtxt(file)
    return np.column_stack([rows[:, 1:3], 2 * np.arctan2(rows[:, 6], rows[:, 7])])


def every_half_metre(log: Path) -> dict[int, Measurement]:
    """A scan every 0.5 m or 0.5 rad of odometry, by its number in the log."""
    measurements = list(CarmenLog(log))
    return {k: measurements[k] for k in thin(np.array([odometry.pose for odometry, _ in measurements]), 0.5, 0.5)}


def list_cases(data: Path, folder: Path) -> Iterator[Case]:
    """Yield all cases; thinned logs are written to a folder."""
    for name in SPARSE:
        yield Case(name, data / "sparse" / f"{name}.clf.gz", 1, gmapping_path(data, name))
    for name in FULL_RATE:
        log = data / f"{name}.clf.bz2"
        poses = map_log(log).trajectory.poses
        kept, thinned = every_half_metre(log), folder / f"{name}.clf"
        write_carmen(thinned, kept.values())
        yield Case(f"{name}, a scan every 0.5 m or 0.5 rad", thinned, 1, poses[list(kept)])
        for every in EVERY:
            yield Case(f"{name}, one scan in {every}", log, every, poses[::every])


def measure(case: Case, seeds: int) -> dict[str, float]:
    """Return errors in m of the final and of the online trajectory: the median of some seeds, and the worst."""
    errors = []
    for seed in range(seeds):
        result = map_log(case.log, seed=seed, options=LogOptions(every=case.every))
        paths = result.trajectory, result.online_trajectory
        errors.append([off_from(path.poses, case.reference) for path in paths])
    medians, worst = np.median(errors, axis=0).round(4).tolist(), np.max(errors, axis=0).round(4).tolist()
    return {"final": medians[0], "final_worst": worst[0], "online": medians[1], "online_worst": worst[1]}


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Print the table and write the figures."""
    parser = make_parser(__doc__)
    parser.add_argument("data", type=Path, help="folder of logs")
    parser.add_argument("--seeds", type=int, default=3)
    parser.set_defaults(out=RESULTS / "far_apart.json")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        found = {case.name: measure(case, given.seeds) for case in list_cases(given.data, Path(folder))}
    rows = [
        [name, *(f"{errors[path]:.3f} ({errors[f'{path}_worst']:.3f})" for path in ("final", "online"))]
        for name, errors in found.items()
    ]
    print(table(["log", "final, m", "online, m"], rows))
    write_document(given.out, logs=found)
    return found


if __name__ == "__main__":
    main()
