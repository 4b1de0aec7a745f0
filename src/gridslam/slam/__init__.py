"""Neither map nor poses known: one file for each algorithm."""

from gridslam.slam.confidence import Confidence
from gridslam.slam.grid_fastslam import GridFastSlam
from gridslam.slam.odometry_tracker import OdometryTracker
from gridslam.slam.proposals import Gaussian, Peak, Prior, Proposal, Proposed
from gridslam.slam.state import STATE_SCHEMA, GridFastSlamState
from gridslam.slam.tracker import Tracked, Tracker, TrackerState

__all__ = [
    "STATE_SCHEMA", "Confidence", "Gaussian", "GridFastSlam", "GridFastSlamState", "OdometryTracker", "Peak", "Prior",
    "Proposal", "Proposed", "Tracked", "Tracker", "TrackerState",
]  # fmt: skip
