"""A page that is asked for too much neither ends the run nor changes its files."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

import support.flood
from support.flood import KINDS

MAP = """
import resource, sys, threading, time
resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024))
from gridslam.cli.main import main

def watch():
    start_s = time.monotonic()
    while True:
        time.sleep(0.2)
        page = 0.0
        for thread in threading.enumerate():
            if thread.name == "MainThread" and thread.ident is not None:
                spent["filter"] = time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
            elif thread.name.startswith("gridslam-live") and thread.ident is not None:
                page += time.clock_gettime(time.pthread_getcpuclockid(thread.ident))
        spent["page"] = max(page, spent.get("page", 0.0))  # its threads end before the run does
        spent["wall"] = time.monotonic() - start_s

spent = {}
threading.Thread(target=watch, daemon=True).start()
status = main()
print("spent", *(f"{spent[name]:.2f}" for name in ("filter", "page", "wall")), file=sys.stderr)
sys.exit(status)
"""
FILES = "map.pgm", "map.yaml", "trajectory.tum", "trajectory.csv", "graph.g2o"


class Run(NamedTuple):
    """Processor time of the filter's thread and of the page's two, time that passed, what visitors counted; s."""

    filter_s: float
    page_s: float
    wall_s: float
    counted: int


def map_live(log: Path, out: Path, kind: str | None = None) -> Run:
    """Map a log with a page while visitors of a kind come."""
    command = [sys.executable, "-c", MAP, "map", str(log), "-o", str(out), "--live", "--live-port", "0"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    log_text = ""
    while (found := re.search(r"live at http://127.0.0.1:(\d+)/", log_text)) is None:
        log_text += run.stderr.readline()
        assert run.poll() is None, log_text
    flood = None
    if kind is not None:
        script = [sys.executable, support.flood.__file__, kind, found[1]]
        flood = subprocess.Popen(script, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    while "the page stays open" not in log_text and run.poll() is None:
        log_text += run.stderr.readline()
    counted = 0
    if flood is not None:
        flood.terminate()
        counted = int((flood.communicate()[0].split() or ["0"])[-1])
    log_text += run.communicate(timeout=60)[1]
    assert run.returncode == 0, log_text
    assert "Traceback" not in log_text, log_text
    return Run(*map(float, log_text.split("spent ")[1].split()), counted)


@pytest.fixture(scope="module")
def quiet(data_dir, tmp_path_factory):
    out = tmp_path_factory.mktemp("quiet") / "out"
    return out, map_live(data_dir / "intel.clf.bz2", out)


@pytest.mark.parametrize("kind", KINDS)
def test_visitors_change_no_file(data_dir, tmp_path, quiet, kind):
    out, alone = quiet
    run = map_live(data_dir / "intel.clf.bz2", tmp_path / "out", kind)
    ratio = run.filter_s / alone.filter_s
    share = run.page_s / run.wall_s
    wall = run.wall_s / alone.wall_s
    print(f"\n{kind}: {run.counted} counted; filter {ratio:.3f} times, page {share:.3f} of the time; {wall:.2f} x wall")
    for name in FILES:
        assert (tmp_path / "out" / name).read_bytes() == (out / name).read_bytes(), name
    assert run.counted > 0
