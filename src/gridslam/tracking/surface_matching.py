"""Matching of a scan to the surfaces that scans before it have seen: exacter than the cells of a map."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.single_pose import Pose
from gridslam.kernels import backend
from gridslam.matching.surfaces import LEAST_INFORMATION
from gridslam.tracking.prediction import PoseEstimate
from gridslam.tracking.recent_scans import RecentScans
from gridslam.types import FloatArray

_GATES_M = np.array([0.15, 0.08])
"""Largest residual of a point, in each step: a match to cells of 5 cm is off by less than the first."""
_MIN_POINTS = 20
_MAX_CORRECTION_M = 0.1
"""Where fewer points are matched, or the scan would move farther, it stays."""
_PRIOR = 1 / np.square([0.02, 0.02, 0.01])
"""Information of the match to the map, from standard deviations in m, m, rad."""
SURFACE_SCANS = 4
"""How many scans of the last metres: with eight the tracker drifts as fast, at twice the cost of a match."""
_SIGMA_M = 0.02
"""Standard deviation of a point; where the residual is as large, it weighs half."""


def match_to_surfaces(recent: RecentScans, ends: FloatArray, found: PoseEstimate) -> Pose:
    """Move a scan that was matched to a map to where the ends of its beams (B, 2) fit surfaces seen in the last metres.

    Point to line, by Gauss-Newton. A map keeps cells, and errors of centimetres with them: matched to surfaces the
    tracker drifts a third as fast. Where few points fit, and along directions that surfaces leave open, the pose stays.

    References
    ----------
    Chen and Medioni, Object modelling by registration of multiple range images (1992); Censi, An ICP variant using a
    point-to-line metric (2008).
    """
    guess = found.pose
    pose, count = backend.match_to_surfaces(
        *recent.surfaces,
        recent.poses,
        ends,
        guess,
        _PRIOR,
        _GATES_M,
        _SIGMA_M,
        LEAST_INFORMATION,
    )
    is_near = math.hypot(pose[0] - guess[0], pose[1] - guess[1]) < _MAX_CORRECTION_M
    return pose if count >= _MIN_POINTS and is_near else guess
