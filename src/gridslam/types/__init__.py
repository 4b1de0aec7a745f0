"""Value types exchanged between components, and the Protocols of exchangeable components.

Poses are rows ``[x m, y m, theta rad]`` with theta in [-pi, pi); grids are ``[row = y, column = x]``; a stamp is int64
nanoseconds; angles are counter-clockwise radians.
"""

from gridslam.scan import (
    BeamEnds,
    Beams,
    BeamStatus,
    EndPoints,
    FloatArray,
    IntArray,
    LaserScan,
    Rows,
    ScanGeometry,
)
from gridslam.types.grid import GridRows, OccupancyGrid
from gridslam.types.protocols import DistanceMaps, MotionModel, MotionSampler, Resampler, SensorModel, Weigher
from gridslam.types.values import Match, Odometry, SkipReason, StepReport, Trajectory, require_measurement, require_step
from gridslam.types.words import describe_pose, describe_time

__all__ = [
    "BeamEnds",
    "BeamStatus",
    "Beams",
    "DistanceMaps",
    "EndPoints",
    "FloatArray",
    "GridRows",
    "IntArray",
    "LaserScan",
    "Match",
    "MotionModel",
    "MotionSampler",
    "OccupancyGrid",
    "Odometry",
    "Resampler",
    "Rows",
    "ScanGeometry",
    "SensorModel",
    "SkipReason",
    "StepReport",
    "Trajectory",
    "Weigher",
    "describe_pose",
    "describe_time",
    "require_measurement",
    "require_step",
]  # fmt: skip
