"""gridslam: 2D lidar SLAM with grid-based FastSLAM (GMapping), loop closure and GraphSLAM.

Names are imported when they are first used, so that ``import gridslam`` itself is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gridslam.api import MapResult, convert_log, map_log
    from gridslam.api.grid import map_with_poses
    from gridslam.api.landmark_localization import localize_by_landmarks
    from gridslam.api.landmarks import map_landmarks
    from gridslam.api.localization import localize
    from gridslam.config import Configuration, build, preset
    from gridslam.doctor import diagnose
    from gridslam.errors import ArgumentError, ConfigurationError, GridslamError, InputError, OutputError
    from gridslam.io.carmen import CarmenLog
    from gridslam.io.log import LogOptions, open_log
    from gridslam.io.map_server import load_map, read_map, write_map
    from gridslam.localization import KnownMap, MonteCarloLocalization, MonteCarloParts
    from gridslam.pipeline import run
    from gridslam.slam.graph_slam import GraphSlam
    from gridslam.slam.grid_fastslam import GridFastSlam
    from gridslam.slam.loop_closure import LoopClosure
    from gridslam.slam.pose_graph import PoseGraph
    from gridslam.slam.state import GridFastSlamState
    from gridslam.types import LaserScan, OccupancyGrid, Odometry, ScanGeometry, StepReport, Trajectory

__all__ = [
    "ArgumentError", "CarmenLog", "Configuration", "ConfigurationError", "GraphSlam", "GridFastSlam",
    "GridFastSlamState", "GridslamError", "InputError", "KnownMap", "LaserScan", "LogOptions", "LoopClosure",
    "MapResult", "MonteCarloLocalization", "MonteCarloParts", "OccupancyGrid", "Odometry", "OutputError", "PoseGraph",
    "ScanGeometry", "StepReport", "Trajectory",
    "__version__", "build", "convert_log", "diagnose", "load_map", "localize", "localize_by_landmarks",
    "map_landmarks", "map_log", "map_with_poses", "open_log", "preset", "read_map", "run", "write_map",
]  # fmt: skip

__version__ = "0.1.0"

_HOMES = {
    "api": ("MapResult", "convert_log", "map_log"),
    "api.grid": ("map_with_poses",),
    "api.landmark_localization": ("localize_by_landmarks",),
    "api.landmarks": ("map_landmarks",),
    "api.localization": ("localize",),
    "config": ("Configuration", "build", "preset"),
    "doctor": ("diagnose",),
    "errors": ("ArgumentError", "ConfigurationError", "GridslamError", "InputError", "OutputError"),
    "io.carmen": ("CarmenLog",),
    "io.log": ("LogOptions", "open_log"),
    "io.map_server": ("load_map", "read_map", "write_map"),
    "localization": ("KnownMap", "MonteCarloLocalization", "MonteCarloParts"),
    "pipeline": ("run",),
    "slam.graph_slam": ("GraphSlam",),
    "slam.grid_fastslam": ("GridFastSlam",),
    "slam.loop_closure": ("LoopClosure",),
    "slam.pose_graph": ("PoseGraph",),
    "slam.state": ("GridFastSlamState",),
    "types": ("LaserScan", "OccupancyGrid", "Odometry", "ScanGeometry", "StepReport", "Trajectory"),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'gridslam' has no attribute {name!r}")
    value: object = getattr(import_module(f"gridslam.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
