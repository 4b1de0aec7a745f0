"""Run the long tier and write a dated report: python tests/long/run.py [pytest arguments].

The report, reports/long-YYYY-MM-DD.md, tells the machine, the commit, and each test with its result, time and figures.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import gridslam
from gridslam.kernels import compiled

ROOT = Path(__file__).resolve().parents[2]


def main(arguments: list[str]) -> int:
    began, clock = time.localtime(), time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        results = Path(folder) / "results.xml"
        command = [
            sys.executable,
            "-m",
            "pytest",
            ROOT / "tests" / "long",
            ROOT / "tests" / "fuzz",
            "-m",
            "long",
            "-o",
            "junit_family=xunit1",
        ]
        command += [f"--junitxml={results}", *arguments]
        status = subprocess.run(command, cwd=ROOT).returncode
        rows = list(outcomes(ET.parse(results).getroot()))
    report = ROOT / "reports" / f"long-{time.strftime('%Y-%m-%d', began)}.md"
    report.parent.mkdir(exist_ok=True)
    lines = [
        f"# Long tests, {time.strftime('%Y-%m-%d %H:%M', began)}",
        *("", f"{'Passed' if status == 0 else 'FAILED'} in {time.perf_counter() - clock:.0f} s.", ""),
        *(f"- {name}: {value}" for name, value in circumstances().items()),
        *("", "| test | result | s | figures |", "| --- | --- | --- | --- |"),
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
    report.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print(f"report: {report}")
    return status


def outcomes(results: ET.Element) -> Iterator[tuple[str, str, str, str]]:
    """Name, result, seconds and figures of each test."""
    for case in results.iter("testcase"):
        kinds = {child.tag for child in case}
        result = next((tag for tag in ("failure", "error", "skipped") if tag in kinds), "passed")
        figures = (f"{item.get('name')}: {item.get('value')}" for item in case.iter("property"))
        name = f"{case.get('classname', '').rpartition('.')[2]}::{case.get('name')}"
        yield name, result, f"{float(case.get('time', 0)):.1f}", "; ".join(figures).replace("|", "\\|")


def circumstances() -> dict[str, str]:
    """What was tested, and on what."""
    return {
        "gridslam": f"{gridslam.__version__}, {'compiled kernels' if compiled else 'NumPy twins'}",
        "commit": git("describe", "--always", "--dirty", "--abbrev=12"),
        "machine": f"{processor()}, {os.cpu_count()} cores, {platform.platform()}",
        "Python": f"{platform.python_version()}, NumPy {np.__version__}",
    }


def git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return done.stdout.strip()


def processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
