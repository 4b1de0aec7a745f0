"""Drives along a route, at a steady rate."""

import math

import numpy as np

from gridslam.sim.robot import Drive


def follow(route, robot, period_s):
    """Poses (N, 3), one each `period_s`, and the leg of the route (N,) that each is on."""
    way = Drive(route, robot)
    return way.at(period_s * np.arange(math.floor(way.duration_s / period_s + 1e-9) + 1, dtype=np.float64))


def drive(route, robot, period_s):
    """Poses (N, 3) alone."""
    return follow(route, robot, period_s)[0]
