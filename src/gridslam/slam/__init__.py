"""Neither map nor poses known: one file for each algorithm."""

from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.slam.grid_fastslam.proposals import (
    ImprovedProposal,
    MotionModelProposal,
    Proposal,
    ProposedPoses,
    ScanMatchedProposal,
)
from gridslam.slam.grid_fastslam.report_builder import ReportBuilder
from gridslam.slam.grid_fastslam.state import STATE_SCHEMA, GridFastSlamState
from gridslam.tracking.tracker import OdometryTracker, TrackedScan, Tracker, TrackerState

__all__ = [
    "STATE_SCHEMA",
    "GridFastSlam",
    "GridFastSlamState",
    "ImprovedProposal",
    "MotionModelProposal",
    "OdometryTracker",
    "Proposal",
    "ProposedPoses",
    "ReportBuilder",
    "ScanMatchedProposal",
    "TrackedScan",
    "Tracker",
    "TrackerState",
]
