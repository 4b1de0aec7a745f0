"""The same log, configuration and seed give the same bytes, whatever the machine does in parallel."""

import os
import subprocess
import sys

import pytest

from gridslam import map_log
from support.loops import PROVOKED

FILES = (
    "trajectory.tum", "trajectory.csv", "trajectory_online.tum", "graph.g2o", "map.pgm", "map.yaml",
)  # fmt: skip  # map.png tells the time it took


def read(folder):
    return {name: (folder / name).read_bytes() for name in FILES}


def saved(log, folder, **options):
    map_log(log, **({"particles": 12} if "configuration" not in options else {}), **options).save(folder)
    return read(folder)


@pytest.fixture(scope="module")
def alone(log, tmp_path_factory):
    return saved(log, tmp_path_factory.mktemp("alone") / "out", seed=3)


@pytest.mark.parametrize("threads", [1, 7])
def test_same_bytes_for_any_number_of_threads(log, tmp_path, alone, threads):
    assert saved(log, tmp_path / "out", seed=3, threads=threads) == alone


def test_same_bytes_with_two_blas_threads(log, tmp_path, alone):
    names = "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"
    environment = os.environ | dict.fromkeys(names, "2")
    command = [sys.executable, "-m", "gridslam", "map", log, "-o", tmp_path, "--particles=12", "--seed=3"]
    subprocess.run(command, check=True, env=environment, capture_output=True)
    assert read(tmp_path) == alone


def test_same_bytes_for_any_number_of_threads_where_a_loop_is_closed_and_the_past_corrected(loop_log, tmp_path):
    first = map_log(loop_log, configuration=PROVOKED, seed=3)
    assert len(first.loop_summary.closures)
    assert first.statistics.corrections
    first.save(tmp_path / "first")
    assert saved(loop_log, tmp_path / "2", configuration=PROVOKED, seed=3, threads=2) == read(tmp_path / "first")
