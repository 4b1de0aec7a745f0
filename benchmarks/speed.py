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
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=self.environment)
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

    def hold(self, particles: int) -> list[str]:
        """Options for that many particles all the time, as the reference has them always."""
        return ["--particles", str(particles), *(["--set", f"particles_min={particles}"] * (self.benchmarks == _HERE))]

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

    def share_of_one_thread(particles: int, *options: str) -> Callable[[Side], dict[str, float]]:
        def measure(side: Side) -> dict[str, float]:
            common = ["--no-loop-closure", *side.hold(particles), *options]
            one, two = (side.map(log, *common, "--threads", count)["wall_s"] for count in "12")
            return {"two_threads": two / one}

        return measure

    def campus_peak(side: Side) -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "campus.clf"
            write_carmen(log, campus(0).simulate().measurements)
            return {"peak_mb": side.map(log)["peak_mb"]}

    def start(side: Side) -> dict[str, float]:
        empty = side.run("-c", "pass")["wall_s"]
        command = "from gridslam.cli.main import main; main()"
        return {
            "import_s": side.run("-c", "import gridslam")["wall_s"] - empty,
            "help_s": side.run("-c", command, "--help")["wall_s"],
            "first_scan_s": side.run("-c", _FIRST_SCAN, str(log))["wall_s"],
        }

    return {
        "alone": Row(lambda side: side.map(log, "--no-loop-closure"), {"user_s": 0.42}, {"peak_mb": 90}),
        "one-particle": Row(lambda side: side.map(log, "--no-loop-closure", "--particles", "1"), {}, {}),
        "full": Row(lambda side: side.map(log), {"user_s": 0.42}, {"peak_mb": 120}),
        "threads-30": Row(share_of_one_thread(30), {}, {"two_threads": 0.75}, 3),
        "threads-300": Row(share_of_one_thread(300, "--duration", "600"), {}, {"two_threads": 0.60}, 3),
        "threads-3000": Row(share_of_one_thread(3000, "--duration", "100"), {}, {"two_threads": 0.60}, 1),
        "kernels": Row(lambda side: side.part("kernels"), {}, {"two_threads": 0.588}),
        "1000": Row(
            lambda side: side.map(log, *side.hold(1000), "--threads", "2", "--duration", "600"),
            {"user_s": 0.42},
            {"peak_mb": 800, "wall_s": 600 / 50},
            1,
        ),
        "dense": Row(
            lambda side: side.part("dense"), {"p99_ms": 0.74, "longest_ms": 0.2}, {"p99_ms": 10, "longest_ms": 40}
        ),
        "map-size": Row(lambda side: side.part("map_size"), {}, {"ratio": 1.1}, 1),
        "2-km": Row(campus_peak, {}, {"peak_mb": 250}, 1),
        "mcl": Row(lambda side: side.part("mcl"), {"ms": 1 / 3}, {}),
        "fastslam2": Row(lambda side: side.part("fastslam2"), {"ms": 1 / 4}, {}),
        "start": Row(start, {}, {"import_s": 0.03, "help_s": 0.10, "first_scan_s": 0.30}),
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
    own = dict(os.environ)
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
