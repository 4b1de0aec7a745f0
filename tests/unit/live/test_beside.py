"""What a finished run is compared with: the truth, another run, a map."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.se2 import compose
from gridslam.io.maps import write_map
from gridslam.io.trajectories import write_tum
from gridslam.live.beside import NOTHING, read_beside
from gridslam.types import Trajectory
from support.localization_world import flat_map

MOVED = np.array([5.0, -2.0, 0.7])


@pytest.fixture
def driven():
    angle = np.linspace(0, 3, 40)
    return Trajectory(np.arange(40) * 10**8, np.column_stack([np.cos(angle), np.sin(2 * angle), angle]))


def test_the_truth_of_the_folder_is_aligned_and_shown_unasked(tmp_path, driven):
    assert read_beside(tmp_path, None, driven) == NOTHING
    write_tum(tmp_path / "truth.tum", Trajectory(driven.stamps_ns, compose(MOVED, driven.poses)))
    found = read_beside(tmp_path, None, driven)
    assert (found.name, found.grid) == ("truth", None)
    assert found.path == pytest.approx(driven.poses[:, :2], abs=1e-5)
    assert read_beside(tmp_path, None, None) == NOTHING


def test_a_trajectory_a_map_or_both(tmp_path, driven):
    other = tmp_path / "monday"
    other.mkdir()
    write_map(other / "map.yaml", flat_map())
    write_tum(other / "late.tum", Trajectory(driven.stamps_ns[20:], compose(MOVED, driven.poses[20:])))
    alone = read_beside(tmp_path, other / "map.yaml", driven)
    assert (alone.name, len(alone.path)) == ("map", 0)
    assert alone.grid.known.any()
    path = read_beside(tmp_path, other / "late.tum", driven).path
    assert path == pytest.approx(driven.poses[20:, :2], abs=1e-5)
    write_tum(other / "trajectory.tum", driven)
    both = read_beside(tmp_path, other, driven)
    assert (both.name, len(both.path)) == ("monday", 40)
    assert both.grid.known.any()
