"""The live node for a day at rest, and for hours about one floor: does its memory stay flat, and a scan as cheap?

    python benchmarks/endurance.py [parked] [driving] [--hours H] [--out benchmarks/results/endurance.json]

`parked`: 24 h at 5 Hz before the walls of an office, with the laser's noise. `driving`: 3 h at 40 Hz, the same lap of
40 m again and again. Each scan is handed to the node's core as a transport does, and the next one follows when it is
mapped, so that an hour of the robot takes minutes. A row for each hour, or for each tenth of fewer: resident memory at
its end, CPU time of the filter's thread for a scan (median and 99th percentile), key scans so far.
"""

from __future__ import annotations

import argparse
import gc
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from gridslam import preset
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.ros import NodeCore, NodeSettings
from gridslam.ros.node.messages import ScanMessage, StampedTransform
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, StepReport
from load import MOUNTING, NoOutputs, odometry_message, resident_mb, scan_message
from measure import write_document

__all__ = ["Watch", "drive", "main"]

RATE_HZ = {"parked": 5.0, "driving": 40.0}
HOURS = {"parked": 24.0, "driving": 3.0}
BEAMS = 360
_PARKED_SCANS = 500
_SEAM_M = 0.05
"""Distance, and rad, up to which two poses of successive laps count as the same."""


@final
class Watch:
    """An observer that notes the filter's CPU time and lets the next scan come."""

    def __init__(self) -> None:
        self.mapped = threading.Semaphore(0)
        self.cpu_s: list[float] = []
        self.key_scans = 0
        self._last_s: float | None = None

    def note(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        now_s = time.thread_time()
        if self._last_s is not None:
            self.cpu_s.append(now_s - self._last_s)
        self._last_s = now_s
        self.key_scans += report.skipped is None
        self.mapped.release()


def drive(kind: str, scans: int) -> Iterator[tuple[StampedTransform, ScanMessage]]:
    """Odometry and scan of each instant, from a second on."""
    rate_hz = RATE_HZ[kind]
    lidar = LidarConfig(beams=BEAMS, range_max_m=30.0, rate_hz=rate_hz, x_m=0.1)
    rng = np.random.default_rng(0)
    rooms = make_world("rooms", rng)
    if kind == "parked":
        lap = simulate(rooms, RobotConfig(), OdometryNoise(), lidar, rng)
        ranges = [lap.measurements[0].scan.ranges + rng.normal(0, 0.01, BEAMS) for _ in range(_PARKED_SCANS)]
        poses = np.zeros((_PARKED_SCANS, 3))
        bearings = lap.measurements[0].scan.geometry.bearings
    else:
        loop = rooms.route[:7]
        laps = World.of("laps", rooms.walls, np.concatenate([loop, loop, loop, loop[:1]]))
        log = simulate(laps, RobotConfig(v_max_m_s=0.6), OdometryNoise(), lidar, rng)
        begin, end = find_lap(log.truth.poses)
        ranges = [measurement.scan.ranges for measurement in log.measurements[begin : end + 1]]
        poses = np.array([m.odometry.pose for m in log.measurements[begin : end + 1] if m.odometry is not None])
        bearings = log.measurements[0].scan.geometry.bearings
    increments = between(poses[:-1], poses[1:])
    pose = np.zeros(3)
    for k in range(scans):
        phase = k % len(increments)
        stamp_ns = round((1 + k / rate_hz) * 1e9)
        yield odometry_message(stamp_ns, pose), scan_message(stamp_ns, bearings, ranges[phase])
        pose = compose(pose, increments[phase])


def find_lap(truth: FloatArray) -> tuple[int, int]:
    """First and last scan of one lap: a pose (N, 3) of the first third, and the same one a lap later."""
    begin = len(truth) // 4
    later = np.arange(begin + len(truth) // 5, len(truth))
    away = np.hypot(*(truth[later] - truth[begin])[:, :2].T) + np.abs(wrap(truth[later, 2] - truth[begin, 2]))
    nearest = int(np.argmin(away[: len(truth) // 3]))
    assert away[nearest] < _SEAM_M, f"the laps differ by {away[nearest]:.3f}"
    return begin, int(later[nearest])


def endure(kind: str, hours: float) -> dict[str, Any]:
    """Map for hours of the robot's time; a row for each hour, or for each tenth."""
    watch = Watch()
    outputs = NoOutputs()
    core = NodeCore(NodeSettings(), preset("default", 30), outputs, observers=[watch.note])
    core.on_transforms([MOUNTING], static=True)
    core.start()
    scans = round(hours * 3600 * RATE_HZ[kind])
    rows: list[dict[str, Any]] = []
    ends = np.linspace(0, scans, max(10, round(hours)) + 1)[1:].astype(int).tolist()
    for sent, (transform, scan) in enumerate(drive(kind, scans), 1):
        core.on_transforms([transform])
        core.on_scan(scan)
        if not watch.mapped.acquire(timeout=120):
            raise SystemExit(f"the node did not map scan {sent}: {outputs.log_lines[-3:]}")
        if sent == ends[len(rows)]:
            gc.collect()
            spent_ms = 1e3 * np.array(watch.cpu_s)
            watch.cpu_s.clear()
            row = {
                "kind": kind,
                "hours": sent / RATE_HZ[kind] / 3600,
                "memory_mb": resident_mb(),
                "scan_ms": float(np.median(spent_ms)),
                "scan_p99_ms": float(np.quantile(spent_ms, 0.99)),
                "scan_max_ms": float(spent_ms.max()),
                "key_scans": watch.key_scans,
            }
            rows.append(row)
            print(_format(row), flush=True)
    core.close()
    return {"kind": kind, "scans": scans, "rows": rows, "log": outputs.log_lines[:20]}


def _format(row: dict[str, Any]) -> str:
    cells = [row["kind"], *(f"{row[name]:.4g}" for name in list(row)[1:])]
    return "| " + " | ".join(cells) + " |"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a row for each hour, and write all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", help="parked, driving [both]")
    parser.add_argument("--hours", type=float, help="of the robot's time [24 parked, 3 driving]")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(arguments)
    head = "| kind | hours | memory, MB | scan, ms | p99 | max | key scans |"
    print(head, "| --- " * 7 + "|", sep="\n")
    runs = [endure(kind, given.hours or HOURS[kind]) for kind in given.kinds or HOURS]
    if given.out is not None:
        table = [head, "| --- " * 7 + "|", *(_format(row) for run in runs for row in run["rows"])]
        write_document(given.out, "the node's core, as fast as it maps", table=table, runs=runs)


if __name__ == "__main__":
    main()
