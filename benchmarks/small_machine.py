"""The live node on a small machine: a quarter of one core and 512 MB, as a share of a Raspberry Pi. Is nothing dropped?

    python benchmarks/small_machine.py [--seconds 120] [--cores 0.25] [--memory 512] [--out FILE]

A robot drives there and back in the simulated office `demo`, and its messages are handed to the node's core at their
pace: 10 Hz, 360 beams, 30 particles. The process runs on one core, in a control group of Linux that gives it a quarter
of each 100 ms, start and simulation included; the limit of its memory is RLIMIT_AS, which counts what is reserved,
too. Where no control group may be made the process runs on its core unlimited, and the CPU time for a second of the
log is what counts: below 0.25 s, a quarter of the core would do.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

__all__ = ["limited_to", "main"]

RATE_HZ, BEAMS, PARTICLES = 10.0, 360, 30
_PERIOD_US = 100_000
_GROUPS = Path("/sys/fs/cgroup")


@contextmanager
def limited_to(cores: float) -> Iterator[tuple[str, Path | None]]:
    """A control group that gives its processes so many cores: how it limits them, and the file that they join by."""
    quota = round(cores * _PERIOD_US)
    two = (_GROUPS / "cgroup.controllers").exists()
    group = (_GROUPS if two else _GROUPS / "cpu") / f"gridslam-{os.getpid()}"
    try:
        group.mkdir()
    except OSError:
        yield "the CPU time is measured, not limited", None
        return
    try:
        if two:
            (group / "cpu.max").write_text(f"{quota} {_PERIOD_US}", encoding="ascii")
        else:
            (group / "cpu.cfs_period_us").write_text(str(_PERIOD_US), encoding="ascii")
            (group / "cpu.cfs_quota_us").write_text(str(quota), encoding="ascii")
        yield f"a control group (version {1 + two}): {quota} us of each {_PERIOD_US} us", group / "cgroup.procs"
    except OSError:
        yield "the CPU time is measured, not limited", None
    finally:
        group.rmdir()


def drive(seconds: float) -> dict[str, Any]:
    """Map so many seconds of a drive in this process; what the node did meanwhile."""
    from load import LATENCY
    from node import load_on_core

    load = load_on_core(seconds, RATE_HZ, BEAMS, PARTICLES)
    latency_ms = 1e3 * load.parts_s[LATENCY]
    return {
        "sent": load.sent,
        "mapped": len(latency_ms),
        "dropped": load.dropped,
        "refused": load.refused,
        "latency_ms": {
            "median": float(np.median(latency_ms)),
            "p99": float(np.percentile(latency_ms, 99)),
            "longest": float(latency_ms.max()),
        },
        "cpu_s_per_s": load.cpu_s / seconds,
        "peak_memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6,
    }


def main(arguments: Sequence[str] | None = None) -> dict[str, Any]:
    """Run, print what came of it, and write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=120.0, help="of the log [120]")
    parser.add_argument("--cores", type=float, default=0.25, help="[0.25]")
    parser.add_argument("--memory", type=int, default=512, help="MB [512]")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--join", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    if given.inside:
        found = drive(given.seconds)
        print(json.dumps(found))
        return found
    with limited_to(given.cores) as (how, join):
        found = _run_inside(given.seconds, given.memory, join)
    found = {"limited_by": how, "cores": given.cores, "memory_limit_mb": given.memory, **found}
    print(json.dumps(found, indent=1))
    if given.out is not None:
        from measure import write_document

        write_document(given.out, f"10 Hz, {BEAMS} beams, {PARTICLES} particles, {given.seconds:g} s, live", **found)
    return found


def _run_inside(seconds: float, memory_mb: int, join: Path | None) -> dict[str, Any]:
    """Map in a process that is limited before it starts anything."""

    def limit() -> None:
        if join is not None:
            join.write_text(str(os.getpid()), encoding="ascii")
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
        resource.setrlimit(resource.RLIMIT_AS, (memory_mb * 1_000_000,) * 2)

    command = [sys.executable, __file__, "--inside", "--seconds", str(seconds)]
    done = subprocess.run(command, preexec_fn=limit, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


if __name__ == "__main__":
    main()
