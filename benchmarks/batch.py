"""Many short logs: `gridslam batch` with one and two workers, against a shell loop of `gridslam map`.

    python benchmarks/batch.py [--logs N] [--out benchmarks/results/batch.json]

Simulated logs of 60 s (301 scans), one thread each. Of each way the wall time and the CPU time; of the batches the
share of the workers' time that no child ran, by the rows of the journal. The children of a batch are timed from their
fork to their end, the workers from the start of the command to its end.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from gridslam.batch.journal import Journal
from gridslam.io.carmen.writer import write_carmen
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate_stream
from measure import GRIDSLAM, write_document

__all__ = ["main", "measure", "write_logs"]

SECONDS = 60
LOOP = 'for log in "$1"/*; do "$0" -m gridslam.cli.main map "$log" -o "$2/$(basename "$log")" || exit 1; done'


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(Path(folder), given.logs)
    one, two, loop = rows["one worker"], rows["two workers"], rows["shell loop"]
    ratios = {
        "two workers, times as fast as one": one["wall_s"] / two["wall_s"],
        "one worker, wall time of the shell loop": one["wall_s"] / loop["wall_s"],
        "one worker, share outside the children": one["outside"],
        "two workers, share outside the children": two["outside"],
    }
    for name, row in rows.items():
        print(f"{name}: {', '.join(f'{key} {value:.3f}' for key, value in row.items())}")
    for name, ratio in ratios.items():
        print(f"{name}: {ratio:.3f}")
    if given.out is not None:
        how = f"{given.logs} simulated logs of {SECONDS} s, one after the other: each way once"
        write_document(given.out, how, logs=given.logs, ways=rows, ratios=ratios)
    return 0


def measure(folder: Path, count: int) -> dict[str, dict[str, float]]:
    """Wall and CPU seconds of each way over the same logs; of batches the share outside the children."""
    logs = folder / "logs"
    write_logs(logs, count)
    rows = {}
    for name, workers in (("two workers", 2), ("one worker", 1)):
        out = folder / name.replace(" ", "-")
        row = timed([*GRIDSLAM, "batch", logs, "-o", out, "--workers", workers])
        with Journal(out) as journal:
            children_s = sum(done["wall_s"] for done in journal.rows())
        rows[name] = row | {"outside": 1 - children_s / (workers * row["wall_s"])}
    rows["shell loop"] = timed(["bash", "-c", LOOP, sys.executable, logs, folder / "loop"])
    return rows


def write_logs(folder: Path, count: int) -> None:
    """Write the first minute of drives through one building, each with noise of its own."""
    folder.mkdir()
    lidar = LidarConfig()
    for seed in range(count):
        rng = np.random.default_rng(seed)
        log = simulate_stream(make_world("rooms", rng), RobotConfig(), OdometryNoise(), lidar, rng)
        write_carmen(folder / f"{seed:04d}.clf.gz", islice(log.measurements, round(SECONDS * lidar.rate_hz) + 1))


def timed(command: Sequence[object]) -> dict[str, float]:
    """Run a command; its wall time, and the CPU time of all its processes."""
    began_s = time.perf_counter()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([str(word) for word in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"wall_s": time.perf_counter() - began_s, "cpu_s": cpu_s, "load": os.getloadavg()[0]}


if __name__ == "__main__":
    sys.exit(main())
