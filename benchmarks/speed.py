"""What this tree costs beside an earlier commit: python benchmarks/speed.py REFERENCE [ROW ...] [-o FILE].

REFERENCE is a checkout of that commit with an environment of its own in .venv, into which it is installed. Both run
alternately, so that what else the machine does meets both; a figure is the median of the runs, beside its target. The
table in docs/performance.md is written from the results.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import NamedTuple, final

from closure_worlds import campus
from gridslam.io.carmen.writer import write_carmen
from measure import RESULTS, write_document
from report import table

_HERE = Path(__file__).resolve().parent
_RESULT = RESULTS / "speed.json"
_PAGE = _HERE.parent / "docs" / "performance.md"
_TABLE = re.compile(r"(?<=<!-- speed -->\n).*?(?=<!-- end of speed -->)", re.DOTALL)


_FIRST_SCAN = """
import sys
import gridslam
odometry, scan = next(iter(gridslam.open_log(sys.argv[1])))
gridslam.build(gridslam.Configuration()).init(odometry, scan)
"""


@final
class Side(NamedTuple):
    """One of the two commits: its interpreter and its folder of benchmarks."""

    python: str
    benchmarks: Path
    environment: dict[str, str]

    def part(self, name: str) -> dict[str, float]:
        """Figures of one part of `speed_parts.py`."""
        command = [self.python, str(_HERE / "speed_parts.py"), name, str(self.benchmarks)]
        one_thread = {**self.environment, "OPENBLAS_NUM_THREADS": "1"}  # as the command has it: idle ones count as CPU
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=one_thread)
        found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
        return found

    def map(self, log: Path, *options: str) -> dict[str, float]:
        """User CPU and wall time (s) and peak memory (MB) of `gridslam map`."""
        with tempfile.TemporaryDirectory() as folder:
            program = "from gridslam.cli.main import main; main()"
            out = Path(folder) / "out"
            figures = self.run("-c", program, "map", str(log), "-o", str(out), "--json", *options)
            document = json.loads((out / "run.json").read_text(encoding="utf-8"))
        return {**figures, "peak_mb": document["peak_memory_bytes"] / 1e6}

    def run(self, *arguments: str) -> dict[str, float]:
        """User CPU and wall time (s) of the interpreter."""
        begin = time.perf_counter()
        process = subprocess.Popen([self.python, *arguments], stdout=subprocess.DEVNULL, env=self.environment)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        if status:
            raise RuntimeError(f"{self.python} {' '.join(arguments)} failed")
        return {"user_s": usage.ru_utime, "wall_s": wall}


@final
class Row(NamedTuple):
    """Something to measure on both sides, and the greatest ratio to the reference, or the greatest value, by figure."""

    measure: Callable[[Side], dict[str, float]]
    ratios: dict[str, float]
    values: dict[str, float]
    runs: int = 5


def rows(log: Path) -> dict[str, Row]:
    """All rows, by name; `log` is the Intel Research Lab."""

    def two_threads(side: Side) -> dict[str, float]:
        one, two = (side.map(log, "--threads", count)["wall_s"] for count in "12")
        return {"two_threads": two / one}

    def campus_drive(side: Side) -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder:
            drive = Path(folder) / "campus.clf"
            write_carmen(drive, campus(0).simulate().measurements)
            return side.map(drive)

    def start(side: Side) -> dict[str, float]:
        empty = side.run("-c", "pass")["wall_s"]
        command = "from gridslam.cli.main import main; main()"
        return {
            "import_s": side.run("-c", "import gridslam")["wall_s"] - empty,
            "help_s": side.run("-c", command, "--help")["wall_s"],
            "first_scan_s": side.run("-c", _FIRST_SCAN, str(log))["wall_s"],
        }

    return {
        "start": Row(start, {}, {"help_s": 0.25, "first_scan_s": 0.6}),
        "full": Row(lambda side: side.map(log), {"user_s": 0.68}, {"peak_mb": 150}),
        "alone": Row(lambda side: side.map(log, "--no-loop-closure"), {"user_s": 0.66}, {}),
        "one-particle": Row(
            lambda side: side.map(log, "--no-loop-closure", "--particles", "1"), {"user_s": 0.7}, {}, 3
        ),
        "threads": Row(two_threads, {}, {"two_threads": 0.65}, 3),
        "dense": Row(lambda side: side.part("dense"), {}, {"p99_ms": 10, "longest_ms": 40}),
        "map-size": Row(lambda side: side.part("map_size"), {}, {"ratio": 1.1}, 1),
        "2-km": Row(campus_drive, {"user_s": 0.7, "peak_mb": 1}, {}, 1),
        "mcl": Row(lambda side: side.part("mcl"), {"ms": 0.71}, {}),
    }


def main(arguments: Sequence[str] | None = None) -> Path:
    """Measure, print, and write the file; returns its path."""
    parser = argparse.ArgumentParser(description="What this tree costs beside an earlier commit.")
    parser.add_argument("reference", type=Path, help="checkout with .venv")
    parser.add_argument("rows", nargs="*", metavar="ROW")
    parser.add_argument("--log", type=Path, default=_HERE.parents[1] / "shared/data/intel.clf.bz2")
    parser.add_argument("--runs", type=int, help="of each row, in place of its own number")
    parser.add_argument("-o", "--out", type=Path, default=_RESULT)
    given = parser.parse_args(arguments)
    reference = given.reference.resolve()
    # as installed: a checkout whose bytecode is not kept would be compiled at each start
    own = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    installed = {name: value for name, value in own.items() if name != "PYTHONPATH"}
    sides = {
        "reference": Side(str(reference / ".venv/bin/python"), reference / "benchmarks", installed),
        "this": Side(sys.executable, _HERE, own),
    }
    commit = subprocess.run(["git", "-C", reference, "rev-parse", "--short", "HEAD"], capture_output=True, text=True)
    figures = json.loads(given.out.read_text(encoding="utf-8"))["rows"] if given.out.exists() else {}
    for name, row in rows(given.log).items():
        if not given.rows or name in given.rows:
            figures[name] = _measure(row, sides, given.runs or row.runs)
            print(name, json.dumps(figures[name]), flush=True)
            write_document(given.out, f"alternately with commit {commit.stdout.strip()}, medians", rows=figures)
    if given.out == _RESULT:
        _write_table(figures)
    path: Path = given.out
    return path


def _measure(row: Row, sides: dict[str, Side], runs: int) -> dict[str, dict[str, float | bool]]:
    """For each figure the medians of both sides, and whether the targets are met."""
    found = [{name: row.measure(side) for name, side in sides.items()} for _ in range(runs)]
    report: dict[str, dict[str, float | bool]] = {}
    for figure in found[0]["this"]:
        this, reference = (median(run[side][figure] for run in found) for side in ("this", "reference"))
        report[figure] = {"this": round(this, 4), "reference": round(reference, 4), "ratio": round(this / reference, 3)}
        report[figure] |= {"runs": runs, "load": round(os.getloadavg()[0], 1)}
        if figure in row.ratios:
            report[figure] |= {
                "ratio_target": round(row.ratios[figure], 3),
                "met": this <= row.ratios[figure] * reference,
            }
        if figure in row.values:
            is_met = bool(report[figure].get("met")) or this <= row.values[figure]
            report[figure] |= {"target": row.values[figure], "met": is_met}
    return report


def _write_table(figures: dict[str, dict[str, dict[str, float | bool]]]) -> None:
    """Write the figures into the page on performance."""
    lines = []
    for row, found in figures.items():
        for figure, values in found.items():
            targets = [f"<= {values['ratio_target']:g} x"] if "ratio_target" in values else []
            targets += [f"<= {values['target']:g}"] if "target" in values else []
            met = {True: "yes", False: "**no**"}.get(bool(values["met"])) if "met" in values else ""
            numbers = [f"{values[name]:.3g}" for name in ("this", "reference", "ratio")]
            lines.append([f"{row}: {figure}", *numbers, " or ".join(targets), met, f"{values['load']:g}"])
    head = ["row: figure", "now", "before", "ratio", "target", "met", "load"]
    page = _PAGE.read_text(encoding="utf-8")
    _PAGE.write_text(_TABLE.sub(lambda _: table(head, lines) + "\n", page), encoding="utf-8")


if __name__ == "__main__":
    print(main())
