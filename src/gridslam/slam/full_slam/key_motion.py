"""Motion between key scans, by the odometry and by tracking."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.se2 import between, compose
from gridslam.geometry.single_pose import as_pose
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.tracking.odometry_calibration import (
    SEGMENT_M,
    SEGMENT_RAD,
    OdometryCalibration,
    OdometryErrorModel,
)

_CALIBRATION = OdometryCalibration(forgetting_segments=1e6)
"""By the whole drive, its beginning and its end alike."""
_TRACKED_LEFT = 0.1
"""Least share of the information of a tracked increment. It was matched to the surfaces that the adjustment matches
again, and where these are weak it errs by several times what is expected of it."""
_REPLACED_RATIO = 10.0
"""Information of a tracked increment over that of the odometry, up to which it is replaced: three times its standard
deviation. Beyond, less is."""
_SLIP_SQUARED = 100.0
"""Normalized square of an error of the odometry, at which it weighs half: wheels slip."""
_DECISIVE = 9.0
"""Normalized square by which the odometry is nearer to tracking than to the graph, so that the latter is wrong."""
_LEAST_SHARE = 0.1
"""Least share of the variance of a segment."""
_OPEN_RATIO = 4.0
"""Ratio of the variances of an open increment, along and across. There the tracker has the odometry's."""


def weigh_odometry(graph: PoseGraph, keys: KeyGraph, is_tracked: NDArray[np.bool_]) -> PoseGraph:
    """Weigh the odometry into the tracked increments of a graph.

    The odometry is the likelihood of the motion that scans know nothing of: along directions that they leave weak, as
    those of a narrow laser or of a few metres' range, it is the better one. Its systematic errors and its noise are
    estimated from the tracked motion, as the graph's may hold jumps of a filter; it counts where that is possible, and
    where wheels do not slip. Its headings are not used: on real robots they lag behind. It decides, too, whether the
    filter jumped along a corridor or the tracker was wrong. What is tracked has the rest, and all where there is no
    odometry.

    Parameters
    ----------
    graph : PoseGraph
        Its first T - 1 measurements are the increments, of which those are weighed that are tracked.
    keys : KeyGraph
        The T key scans.
    is_tracked : (T - 1,) bool
        Without a gap in the laser data.

    References
    ----------
    Probabilistic Robotics, section 5.4.
    """
    errors = _estimate_errors(keys, is_tracked)
    if not (errors.trusted and _CALIBRATION.is_known(errors)):
        return graph
    odometry = np.array(keys.odometry)
    raw = between(odometry[:-1], odometry[1:])
    own = np.flatnonzero(is_tracked & np.isfinite(raw).all(axis=1))
    corrected = np.array([errors.correct_increment(as_pose(moved)) for moved in raw[own]]).reshape(-1, 3)
    shares = np.maximum(np.hypot(corrected[:, 0], corrected[:, 1]) / SEGMENT_M, np.abs(corrected[:, 2]) / SEGMENT_RAD)
    variances = np.maximum(shares, _LEAST_SHARE) * errors.variances[0]
    poses = np.array(keys.tracked)
    given, moved = graph.measurements[own], between(poses[own], poses[own + 1])
    missed, other = (np.square(between(corrected, of)[:, :2]).sum(axis=1) / variances for of in (given, moved))
    is_better = missed - other > _DECISIVE
    given = np.where(is_better[:, None], moved, given)
    weights = 1 / (1 + np.square(np.where(is_better, other, missed) / _SLIP_SQUARED))
    tracked = graph.information[own]
    ratio = 2 / (variances * np.trace(tracked[:, :2, :2], axis1=1, axis2=2))
    certainty = np.minimum(np.square(_REPLACED_RATIO * ratio), 1.0)
    tracked = tracked * (1 - (1 - _TRACKED_LEFT) * weights * certainty)[:, None, None]
    by_odometry = (weights / variances)[:, None, None] * np.diag([1.0, 1.0, 0.0])
    measurements, information = graph.measurements.copy(), graph.information.copy()
    information[own] = tracked + by_odometry
    steps = np.linalg.solve(information[own], by_odometry @ between(given, corrected)[..., None])[..., 0]
    measurements[own] = compose(given, steps)
    return replace(graph, measurements=measurements, information=information)


def _estimate_errors(keys: KeyGraph, is_tracked: NDArray[np.bool_]) -> OdometryErrorModel:
    """Estimate the errors of the odometry from the tracked motion."""
    variances = np.linalg.eigvalsh(np.array(keys.covariances)[1:, :2, :2])
    is_determined = variances[:, 1] < _OPEN_RATIO * variances[:, 0]
    errors = OdometryErrorModel(begin_pose=as_pose(keys.tracked[0]), begin_odometry=as_pose(keys.odometry[0]))
    for key, (is_good, determined) in enumerate(zip(is_tracked.tolist(), is_determined.tolist(), strict=True), start=1):
        _CALIBRATION.learn(errors, as_pose(keys.tracked[key]), as_pose(keys.odometry[key]), is_good, determined)
    return errors
