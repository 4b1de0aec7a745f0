"""A page that is asked for too much neither ends the run nor changes its files."""

from __future__ import annotations

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


def map_live(log: Path, out: Path, kind: str | None = None) -> int:
    """Map a log with a page while visitors of a kind come; what they counted."""
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
    return counted


@pytest.fixture(scope="module")
def quiet(data_dir, tmp_path_factory):
    out = tmp_path_factory.mktemp("quiet") / "out"
    map_live(data_dir / "intel.clf.bz2", out)
    return out


@pytest.mark.parametrize("kind", KINDS)
def test_visitors_change_no_file(data_dir, tmp_path, quiet, kind):
    assert map_live(data_dir / "intel.clf.bz2", tmp_path / "out", kind) > 0
    for name in FILES:
        assert (tmp_path / "out" / name).read_bytes() == (quiet / name).read_bytes(), name
