"""A page that is asked for too much becomes slow, and not the run: its files are those of a run without visitors."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import support.flood
from support.flood import KINDS

MAP = """
import resource, sys
resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024))
from gridslam.cli.main import main
sys.exit(main())
"""
FILES = "map.pgm", "map.yaml", "trajectory.tum", "trajectory.csv", "graph.g2o"
SLOWDOWN = 1.2


def map_live(log: Path, out: Path, kind: str | None = None) -> tuple[dict, int]:
    """Map a log with a page while visitors of a kind come; returns run.json and what they have counted."""
    command = [sys.executable, "-c", MAP, "map", str(log), "-o", str(out), "--live", "--live-port", "0"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    told = ""
    while (found := re.search(r"live at http://127.0.0.1:(\d+)/", told)) is None:
        told += run.stderr.readline()
        assert run.poll() is None, told
    flood = None
    if kind is not None:
        script = [sys.executable, support.flood.__file__, kind, found[1]]
        flood = subprocess.Popen(script, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    while "the page stays open" not in told and run.poll() is None:
        told += run.stderr.readline()
    counted = 0
    if flood is not None:
        flood.terminate()
        counted = int((flood.communicate()[0].split() or ["0"])[-1])
    told += run.communicate(timeout=60)[1]
    assert run.returncode == 0, told
    assert "Traceback" not in told, told
    return json.loads((out / "run.json").read_text()), counted


def seconds(document: dict, clock: str) -> float:
    """Time of the filter's steps."""
    return sum(document["time"]["stages"][stage][clock] for stage in ("track", "step"))


@pytest.fixture(scope="module")
def quiet(data_dir, tmp_path_factory):
    out = tmp_path_factory.mktemp("quiet") / "out"
    return out, map_live(data_dir / "intel.clf.bz2", out)[0]


@pytest.mark.parametrize("kind", KINDS)
def test_visitors_hold_no_run_up(data_dir, tmp_path, quiet, kind):
    """By the processor time of all threads, as other processes are at work, the flood among them."""
    out, alone = quiet
    document, counted = map_live(data_dir / "intel.clf.bz2", tmp_path / "out", kind)
    ratio = seconds(document, "cpu_s") / seconds(alone, "cpu_s")
    wall = seconds(document, "wall_s") / seconds(alone, "wall_s")
    print(f"{kind}: {counted} counted, steps {ratio:.2f} times the processor time, {wall:.2f} times the wall time")
    for name in FILES:
        assert (tmp_path / "out" / name).read_bytes() == (out / name).read_bytes(), name
    assert counted > 0
    assert ratio <= SLOWDOWN
