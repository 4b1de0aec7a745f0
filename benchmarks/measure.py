"""What a command costs, in seconds and in yardsticks, and what it ran on."""

from __future__ import annotations

import datetime
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam import Trajectory, __version__
from gridslam.io.trajectories import read_tum
from gridslam.kernels import backend, compiled

GRIDSLAM = (sys.executable, "-m", "gridslam.cli.main")
RESULTS = Path(__file__).resolve().parent / "results"
_ROOT = RESULTS.parents[1]


def yardstick_s() -> float:
    """CPU seconds of a fixed piece of work, the least of three: costs divided by it compare between machines."""
    return min(_fixed_work() for _ in range(3))


def _fixed_work() -> float:
    rng = np.random.default_rng(0)
    begin = time.process_time()
    for _ in range(3):
        values = rng.random(2_000_000)
        values.sort()
        np.sin(values).sum()
    table: dict[int, int] = {}
    for i in range(1_000_000):
        table[i & 1023] = 3 * i
    return time.process_time() - begin


@final
@dataclass(frozen=True)
class Cost:
    """Wall and CPU (user + system) seconds of a process, and the yardstick around it: mean of before and after."""

    wall_s: float
    cpu_s: float
    yardstick_s: float

    @property
    def yardsticks(self) -> float:
        return self.cpu_s / self.yardstick_s


def timed(command: Sequence[str | Path]) -> Cost:
    """Run a command to its end; raises RuntimeError with what it said where it fails."""
    before = yardstick_s()
    with tempfile.TemporaryFile() as said:
        begin = time.perf_counter()
        process = subprocess.Popen([*map(str, command)], stdout=subprocess.DEVNULL, stderr=said)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            raise RuntimeError(f"{' '.join(map(str, command))}: {said.read().decode(errors='replace')}")
    return Cost(wall, usage.ru_utime + usage.ru_stime, (before + yardstick_s()) / 2)


@final
@dataclass(frozen=True)
class MapRun:
    """One `gridslam map`: its cost, its run.json and its trajectory."""

    cost: Cost
    document: dict[str, Any]
    trajectory: Trajectory

    @property
    def peak_mb(self) -> float:
        """Peak memory as the process itself saw it: what `wait4` tells may be that of its parent, this one."""
        return float(self.document["peak_memory_bytes"]) / 1e6

    @property
    def latency_ms(self) -> dict[str, float]:
        """Of all scans: median, 99 of 100, longest."""
        latency = self.document["latency"]["all_scans"]
        return {name: 1e3 * float(latency[f"{name}_s"]) for name in ("median", "p99", "max")}


def map_timed(log: Path, *options: str | int, picture: Path | None = None) -> MapRun:
    """Run `gridslam map` on a log; its map.png is kept as `picture`."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        cost = timed([*GRIDSLAM, "map", log, "-o", out, "--json", *map(str, options)])
        if picture is not None:
            picture.parent.mkdir(parents=True, exist_ok=True)
            picture.write_bytes((out / "map.png").read_bytes())
        document = json.loads((out / "run.json").read_text(encoding="utf-8"))
        return MapRun(cost, document, read_tum(out / "trajectory.tum"))


def provenance() -> dict[str, str]:
    """Machine, software and commit."""
    return {
        "machine": f"{_cpu_model()}, {len(_cores())} cores, {platform.system()} {platform.machine()}",
        "Python, NumPy": f"{platform.python_version()}, {np.__version__}",
        "kernels": f"compiled by {_compiler()}" if compiled else "NumPy twins (not compiled)",
        "gridslam": f"{__version__}, commit {_commit()}",
        "load, yardstick": f"{_load()}, {yardstick_s():.3f} s",
    }


def document(how: str, **figures: object) -> dict[str, Any]:
    """Figures as a file to be committed: with how they were measured, when, of which commit, and on which machine."""
    machine = provenance()
    commit = machine.pop("gridslam").rpartition("commit ")[2]
    date = datetime.date.today().isoformat()
    return {
        "schema": "gridslam.benchmark/1",
        "date": date,
        "commit": commit,
        "machine": machine,
        "how": how,
        **figures,
    }


def write_document(path: Path, how: str, **figures: object) -> None:
    """Write a `document` as JSON."""
    path.write_text(json.dumps(document(how, **figures), indent=1) + "\n", encoding="utf-8")


def _cores() -> set[int]:
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))


def _load() -> str:
    """Processes that wanted a core in the last minute: with others at work, latencies and wall times are theirs too."""
    return f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"


def _cpu_model() -> str:
    try:
        found = re.search(r"model name\s*: (.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    except OSError:
        found = None
    return found[1] if found else platform.processor() or "unknown CPU"


def _compiler() -> str:
    """The name that compilers leave in what they built."""
    found = re.search(rb"GCC: \([^)]*\) [\d.]+|clang version [\d.]+", Path(backend.__file__).read_bytes())
    return found[0].decode() if found else "an unknown compiler"


def _commit() -> str:
    def git(*arguments: str) -> str:
        return subprocess.run(["git", *arguments], cwd=_ROOT, capture_output=True, text=True, check=True).stdout.strip()

    try:
        changes = git("status", "--porcelain", "--untracked-files=no").splitlines()
        return git("rev-parse", "--short=12", "HEAD") + (f" with {len(changes)} files changed" if changes else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
