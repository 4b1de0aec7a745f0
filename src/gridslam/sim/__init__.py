"""Simulated buildings, robots and lidars: logs whose truth is known."""

from gridslam.sim.lidar import LidarConfig
from gridslam.sim.robot import OdometryNoise, RobotConfig
from gridslam.sim.simulate import PeopleConfig, SimulatedLog, simulate
from gridslam.sim.worlds import WORLDS, World, make_world

__all__ = [
    "WORLDS", "LidarConfig", "OdometryNoise", "PeopleConfig", "RobotConfig", "SimulatedLog", "World", "make_world",
    "simulate",
]  # fmt: skip
