"""Value types exchanged between components, and the Protocols of exchangeable components.

Poses are rows ``[x m, y m, theta rad]`` with theta in [-pi, pi); grids are ``[row = y, column = x]``; a stamp is int64
nanoseconds; angles are counter-clockwise radians.
"""

from gridslam.scan import (
    BeamEnds,
    Beams,
    BeamStatus,
    FloatArray,
    Int32Array,
    IntArray,
    LaserScan,
    Points,
    Poses,
    Rows,
    ScanGeometry,
    StoredScan,
)
from gridslam.types.grid import GridRows, OccupancyGrid
from gridslam.types.ownership import OwnedState
from gridslam.types.protocols import DistanceMaps, MotionModel, MotionSampler, Resampler, ScanLikelihood, SensorModel
from gridslam.types.values import (
    Match,
    Odometry,
    SkipReason,
    StepReport,
    Trajectory,
    describe_duration,
    describe_pose,
    describe_time,
    require_measurement,
    require_step,
)

__all__ = [
    "BeamEnds",
    "BeamStatus",
    "Beams",
    "DistanceMaps",
    "FloatArray",
    "GridRows",
    "Int32Array",
    "IntArray",
    "LaserScan",
    "Match",
    "MotionModel",
    "MotionSampler",
    "OccupancyGrid",
    "Odometry",
    "OwnedState",
    "Points",
    "Poses",
    "Resampler",
    "Rows",
    "ScanGeometry",
    "ScanLikelihood",
    "SensorModel",
    "SkipReason",
    "StepReport",
    "StoredScan",
    "Trajectory",
    "describe_duration",
    "describe_pose",
    "describe_time",
    "require_measurement",
    "require_step",
]
