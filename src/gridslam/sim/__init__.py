"""Simulated buildings, robots and lidars: logs whose truth is known.

`make_world` knows, by name: buildings that are always the same (`demo`, `loop`, `rooms`, `hall`, `corridor`), and
buildings drawn from a seed: `random`.
"""

from gridslam.sim.lidar import LidarConfig
from gridslam.sim.robot import OdometryNoise, RobotConfig
from gridslam.sim.simulate import PeopleConfig, SimulatedLog, simulate
from gridslam.sim.world import Change, World, vary_route
from gridslam.sim.worlds import DRAWN_WORLDS, WORLDS, make_world

__all__ = [
    "DRAWN_WORLDS",
    "WORLDS",
    "Change",
    "LidarConfig",
    "OdometryNoise",
    "PeopleConfig",
    "RobotConfig",
    "SimulatedLog",
    "World",
    "make_world",
    "simulate",
    "vary_route",
]
