"""The public names and the modules they come from: the one list, read by type checkers and by ``__init__.py``.

Each line has the form ``from MODULE import NAME as NAME``.
"""

from gridslam.api.conversion import Conversion as Conversion
from gridslam.api.conversion import convert_log as convert_log
from gridslam.api.grid import GridResult as GridResult
from gridslam.api.grid import map_with_poses as map_with_poses
from gridslam.api.landmark_localization import LandmarkLocalizationResult as LandmarkLocalizationResult
from gridslam.api.landmark_localization import localize_by_landmarks as localize_by_landmarks
from gridslam.api.landmarks import LandmarkResult as LandmarkResult
from gridslam.api.landmarks import map_landmarks as map_landmarks
from gridslam.api.localization import LocalizationResult as LocalizationResult
from gridslam.api.localization import localize as localize
from gridslam.api.mapping import MapResult as MapResult
from gridslam.api.mapping import map_log as map_log
from gridslam.api.session import Session as Session
from gridslam.config import Configuration as Configuration
from gridslam.config import build as build
from gridslam.config import preset as preset
from gridslam.doctor import Diagnosis as Diagnosis
from gridslam.doctor import diagnose as diagnose
from gridslam.errors import ArgumentError as ArgumentError
from gridslam.errors import ConfigurationError as ConfigurationError
from gridslam.errors import ConsumedStateError as ConsumedStateError
from gridslam.errors import GridslamError as GridslamError
from gridslam.errors import InputError as InputError
from gridslam.errors import MissingDependencyError as MissingDependencyError
from gridslam.errors import OutputError as OutputError
from gridslam.io.carmen.reader import CarmenLog as CarmenLog
from gridslam.io.log import Log as Log
from gridslam.io.log import LogOptions as LogOptions
from gridslam.io.log import open_log as open_log
from gridslam.io.maps import read_map as read_map
from gridslam.io.maps import write_map as write_map
from gridslam.localization import KnownMap as KnownMap
from gridslam.localization import MonteCarloConfiguration as MonteCarloConfiguration
from gridslam.localization import MonteCarloLocalization as MonteCarloLocalization
from gridslam.pipeline import run as run
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam as GridFastSlam
from gridslam.slam.grid_fastslam.state import GridFastSlamState as GridFastSlamState
from gridslam.slam.loop_closure.loop_closure import LoopClosure as LoopClosure
from gridslam.slam.pose_graph.graph_slam import GraphSlam as GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph as PoseGraph
from gridslam.types import BeamStatus as BeamStatus
from gridslam.types import LaserScan as LaserScan
from gridslam.types import OccupancyGrid as OccupancyGrid
from gridslam.types import Odometry as Odometry
from gridslam.types import ScanGeometry as ScanGeometry
from gridslam.types import SkipReason as SkipReason
from gridslam.types import StepReport as StepReport
from gridslam.types import Trajectory as Trajectory

__version__: str
__all__: list[str]

def __dir__() -> list[str]: ...
