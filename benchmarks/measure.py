"""Results as files to be committed, with the commit and the machine that they were measured on."""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from gridslam import __version__
from gridslam.kernels import backend, compiled

RESULTS = Path(__file__).resolve().parent / "results"
_ROOT = RESULTS.parents[1]


def provenance() -> dict[str, str]:
    """Machine, software and commit."""
    return {
        "machine": f"{_cpu_model()}, {len(_cores())} cores, {platform.system()} {platform.machine()}",
        "Python, NumPy": f"{platform.python_version()}, {np.__version__}",
        "kernels": f"compiled by {_compiler()}" if compiled else "NumPy twins (not compiled)",
        "gridslam": f"{__version__}, commit {_commit()}",
        "load": _load(),
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


def write_document(path: Path | None, how: str = "", **figures: object) -> None:
    """Write a `document` as JSON, where a path is given; measured as the command line says, if nothing else does."""
    if path is not None:
        how = how or shlex.join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]])
        path.write_text(json.dumps(document(how, **figures), indent=1) + "\n", encoding="utf-8")


def make_parser(description: str | None) -> argparse.ArgumentParser:
    """Make a parser with the option --out, the file that figures are written to."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="write the figures here")
    return parser


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
