"""The live node under load: what passes from a scan's coming to the transform's going, what is dropped, what it costs.

python benchmarks/node.py [--seconds 600] [--rate 40 --rate 400] [--beams 1080] [--transport core|dds] [--grid]

A robot drives there and back in the simulated office `demo`, at 1 m/s. With the transport `core` its messages are
handed to the node in this process, as a transport's callbacks do; with `dds` the command `gridslam ros2` is a process
of its own, on the loopback. `--grid` tells what a grid of 1000 x 1000 cells costs to publish.
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Sequence
from typing import final

import numpy as np

from gridslam import preset
from gridslam.pipeline import Stopwatch
from gridslam.ros import NodeCore, NodeSettings
from gridslam.ros.node.messages import PoseMessage
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import StepReport
from load import LATENCY, MOUNTING, START_S, Load, NoOutputs, drive, resident_mb
from measure import provenance
from node_dds import grid_ms, load_on_dds
from report import Report, Target, table

__all__ = ["TimedOutputs", "load_on_core", "main"]

LATENCY_MS, BEHIND_MS = 25.0, 1000.0
"""Targets: of 99 in 100 scans at the usual rate, and of all at ten times that."""
SPREAD = 1.1
"""Memory at the end over that after half of the time, up to which it counts as flat."""
GRID_MS = 5.0

_RATE_HZ, _BEAMS, _SECONDS = 40.0, 1080, 60.0


@final
class TimedOutputs(NoOutputs):
    """Outputs that note when a scan's pose, and with it its transform, was sent; and the filter's own times."""

    def __init__(self) -> None:
        super().__init__()
        self.came_s: dict[int, float] = {}
        self.latency_s: dict[int, float] = {}
        self.step_s: dict[int, float] = {}
        self.cpu_s: dict[int, float] = {}
        self.corrections = 0

    def pose(self, message: PoseMessage) -> None:
        self.latency_s[message.stamp_ns] = time.perf_counter() - self.came_s[message.stamp_ns]

    def note(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        self.step_s[report.stamp_ns] = seconds
        self.cpu_s[report.stamp_ns] = time.thread_time()
        self.corrections += report.corrected


def load_on_core(seconds: float, rate_hz: float, beams: int, particles: int) -> Load:
    """Hand a drive to the core in this process, at its pace; what the driver itself costs is not counted."""
    messages, outputs = list(drive(seconds, rate_hz, beams)), TimedOutputs()
    core = NodeCore(NodeSettings(), preset("default", particles), outputs, observers=[outputs.note])
    core.on_transforms([MOUNTING], static=True)
    core.start()
    driver_s, memory_mb = [0.0], list[float]()
    watch, begin_s, begin_ns = Stopwatch(), time.perf_counter() + START_S, time.time_ns() + round(START_S * 1e9)

    def send() -> None:
        for transform, scan in messages:
            due_s, stamp_ns = begin_s + scan.stamp_ns * 1e-9, begin_ns + scan.stamp_ns
            time.sleep(max(0.0, due_s - time.perf_counter()))
            core.on_transforms([transform._replace(stamp_ns=stamp_ns)])
            outputs.came_s[stamp_ns] = time.perf_counter()
            core.on_scan(scan._replace(stamp_ns=stamp_ns), "/scan")
        driver_s[0] = time.thread_time()

    driver = threading.Thread(target=send)
    driver.start()
    while driver.is_alive():
        driver.join(1.0)
        memory_mb.append(resident_mb())
    time.sleep(START_S)  # what is queued is mapped yet
    core.close()
    watch.lap("node")
    counts = {name: int(value) for name, value in core.diagnostics().values.items() if value.isdecimal()}
    latency, step, clock = (np.array([*of.values()]) for of in (outputs.latency_s, outputs.step_s, outputs.cpu_s))
    parts = {
        LATENCY: latency,
        "of it the step": step,
        "of it waiting and telling": latency - step,
        "CPU of the filter's thread": np.diff(clock, prepend=clock[0]),
    }
    return Load(
        parts,
        len(messages),
        counts["dropped"],
        counts["refused"],
        outputs.corrections,
        watch.stages["node"][1] - driver_s[0],
        memory_mb,
    )


def tell(report: Report, title: str, load: Load, rate_hz: float) -> None:
    """Add a section, and the targets that hold at such a rate."""
    rows: list[list[object]] = []
    for name, values in load.parts_s.items():
        ms = 1e3 * values
        rows.append([name, float(np.median(ms)), *np.percentile(ms, (99, 99.9)).tolist(), float(ms.max())])
    memory = load.memory_mb
    start, half, end = (memory[min(len(memory) - 1, int(share * len(memory)))] for share in (0.1, 0.5, 1.0))
    latency_ms = 1e3 * load.parts_s[LATENCY]
    mapped = len(latency_ms)
    facts = (
        f"{load.sent} scans sent, {mapped} mapped, {load.dropped} dropped, {load.refused} refused; {load.corrections} "
        f"corrections of the past; {1e3 * load.cpu_s / max(mapped, 1):.2f} ms CPU a mapped scan. "
        f"Memory {start:.0f} MB after a tenth of the time, {half:.0f} MB after half, {end:.0f} MB in the end."
    )
    report.add(title, table(["ms", "median", "99 of 100", "999 of 1000", "longest"], rows), facts)
    p99_ms, longest_ms = float(np.percentile(latency_ms, 99)), float(latency_ms.max())
    if rate_hz <= _RATE_HZ:
        report.targets += [
            Target(f"{title}: dropped", load.dropped + load.refused, 0.0, unit="scans"),
            Target(f"{title}: 99 of 100", p99_ms, LATENCY_MS, unit="ms"),
        ]
    report.targets += [
        Target(f"{title}: behind at most", longest_ms, BEHIND_MS, unit="ms"),
        Target(f"{title}: memory, end over half", end / half, SPREAD),
    ]


def main(arguments: Sequence[str] | None = None) -> Report:
    """Run what is asked for, and print it."""
    given = _parser().parse_args(arguments)
    report = Report()
    print("\n".join(f"- {name}: {value}" for name, value in provenance().items()))
    if given.grid:
        rows = grid_ms()
        report.add("A grid of 1000 x 1000 cells, DDS", table(["", "ms"], rows))
        report.targets += [Target(f"grid, {name}", value, GRID_MS, unit="ms") for name, value in rows]
    run = load_on_dds if given.transport == "dds" else load_on_core
    for rate in given.rate or ([] if given.grid else [_RATE_HZ]):
        load = run(given.seconds, rate, given.beams, given.particles)
        tell(report, f"{rate:g} scans/s, {given.transport}", load, rate)
    print(f"\n## Targets\n\n{report.summary()}")
    return report


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description="The live node under load.")
    parser.add_argument("--seconds", type=float, default=_SECONDS, help="how long it drives [60]")
    parser.add_argument("--rate", type=float, action="append", help="scans a second [40]; may be repeated")
    parser.add_argument("--beams", type=int, default=_BEAMS, help="of a scan [1080]")
    parser.add_argument("--particles", type=int, default=30, help="[30]")
    parser.add_argument("--grid", action="store_true", help="tell what a large map costs to publish")
    parser.add_argument("--transport", choices=("core", "dds"), default="core", help="[core]")
    return parser


if __name__ == "__main__":
    main()
