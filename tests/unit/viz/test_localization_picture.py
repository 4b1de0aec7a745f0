"""The picture of a localization: the way where the robot was found, dots where it was lost."""

import numpy as np

from gridslam.types import Trajectory
from gridslam.viz.canvas import CLOSURE, LOST
from gridslam.viz.picture import draw_localization
from support.localization_world import drive, flat_map


def painted(page, colour):
    return int((np.asarray(page) == colour).all(axis=2).sum())


def test_where_it_was_lost_and_found():
    grid, truth = flat_map(), drive(1).truth
    lost = np.zeros(len(truth), bool)
    clean = draw_localization(grid, truth, lost, title="flat", caption=["one", "two"])
    assert painted(clean, LOST) == 0
    lost[:30] = True
    page = draw_localization(grid, truth, lost, title="flat", caption=["one", "two"])
    assert page.size == clean.size
    assert painted(page, LOST) > 200
    assert painted(page, CLOSURE) > 50
    everywhere = draw_localization(grid, truth, np.ones(len(truth), bool))
    assert painted(everywhere, LOST) > painted(page, LOST)


def test_poses_off_the_map_and_jumps():
    grid, truth = flat_map(), drive(1).truth
    poses = truth.poses.copy()
    poses[50:60, :2] += 500.0
    page = draw_localization(grid, Trajectory(truth.stamps_ns, poses), np.zeros(len(poses), bool))
    assert max(page.size) >= 1400
