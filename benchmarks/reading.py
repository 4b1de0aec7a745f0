"""How fast bags are read: scans of 360 beams with odometry and transforms, by format, from the disk to measurements.

python benchmarks/reading.py [--scans 10000]
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gridslam import LaserScan, Odometry, ScanGeometry
from gridslam.io.bags.bag import BagLog
from gridslam.io.bags.writer import write_bag
from gridslam.io.measurement import Measurement
from report import Report, Target, table

__all__ = ["reading"]

_BEAMS = 360
_NAMES = {"ROS 1 .bag": "log.bag", "ROS 2 .db3": "log.db3", "ROS 2 .mcap": "log.mcap"}
_LEAST_PER_S = 15_000


def reading(report: Report, scans: int = 10_000, repeats: int = 3) -> None:
    """Write a bag of each format, read it `repeats` times, and again a fourth of it: its memory must be the same."""
    rows: list[list[object]] = []
    with tempfile.TemporaryDirectory() as folder:
        for kind, name in _NAMES.items():
            path = Path(folder) / name
            write_bag(path, _drive(scans // 4))
            part_mb = _peak_mb(path)
            write_bag(path, _drive(scans))
            per_s = scans / statistics.median(_seconds(path) for _ in range(repeats))
            peak_mb = _peak_mb(path)
            rows.append([kind, path.stat().st_size / 1e6, per_s, part_mb, peak_mb])
            report.targets += [
                Target(f"reading {kind}: CPU of a scan", 1e6 / per_s, 1e6 / _LEAST_PER_S, unit="us"),
                Target(f"reading {kind}: memory, to that of a fourth", peak_mb / part_mb, 1.25),
            ]
            path.unlink()
    head = ["format", "MB", "scans/s", "peak MB, a fourth of it", "peak MB"]
    title = f"Reading bags: {scans} scans of {_BEAMS} beams with odometry and transforms, median of {repeats}, one core"
    report.add(title, table(head, rows))


def _drive(scans: int) -> Iterator[Measurement]:
    """Scans at 40 Hz; what the beams measure does not matter here."""
    rng = np.random.default_rng(0)
    geometry = ScanGeometry.planar(np.linspace(-np.pi, np.pi, _BEAMS, endpoint=False), [0.1, 0.0, 0.0])
    for step in range(scans):
        stamp_ns = 10**18 + step * 25_000_000
        ranges = rng.uniform(1.0, 29.0, _BEAMS)
        scan = LaserScan.from_ranges(stamp_ns, ranges, geometry, range_min_m=0.1, range_max_m=30.0)
        yield Measurement(Odometry.at(stamp_ns, [0.01 * step, 0.0, 0.0]), scan)


def _seconds(path: Path) -> float:
    """CPU seconds from the opening to the last measurement."""
    begin = time.process_time()
    for _ in BagLog(path):
        pass
    return time.process_time() - begin


def _peak_mb(path: Path) -> float:
    """Peak of the memory that Python allocates while it reads."""
    tracemalloc.start()
    for _ in BagLog(path):
        pass
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description="How fast bags are read.")
    parser.add_argument("--scans", type=int, default=10_000)
    report = Report()
    reading(report, parser.parse_args().scans)
    print(f"\n{report.summary()}")


if __name__ == "__main__":
    main()
