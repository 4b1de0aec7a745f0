"""The same log, configuration and seed give the same bytes, whatever the machine does in parallel."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from gridslam import map_log

FILES = "trajectory.tum", "trajectory_online.tum", "map.pgm", "map.yaml"  # map.png tells the time it took


def saved(log, folder, **options):
    map_log(log, particles=12, **options).save(folder)
    return {name: (folder / name).read_bytes() for name in FILES}


@pytest.fixture(scope="module")
def alone(log, tmp_path_factory):
    return saved(log, tmp_path_factory.mktemp("alone") / "out", seed=3)


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
def test_same_bytes_for_any_number_of_threads(log, tmp_path, alone, threads):
    assert saved(log, tmp_path / "out", seed=3, threads=threads) == alone


@pytest.mark.parametrize("blas_threads", ["1", "2"])
def test_same_bytes_for_any_number_of_blas_threads(log, tmp_path, alone, blas_threads):
    names = "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"
    environment = os.environ | dict.fromkeys(names, blas_threads)
    command = [sys.executable, "-m", "gridslam.cli.main", "map", log, "-o", tmp_path, "--particles=12", "--seed=3"]
    subprocess.run(command, check=True, env=environment, capture_output=True)
    assert {name: (tmp_path / name).read_bytes() for name in alone} == alone


def test_another_seed_gives_another_trajectory(log, tmp_path, alone):
    assert saved(log, tmp_path / "out", seed=4)["trajectory.tum"] != alone["trajectory.tum"]
