"""Whether the odometry can be true: it is compared with the motion from scan to scan."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, final

import numpy as np

from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.single_pose import Pose, between
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.parameters import bounded, parameters
from gridslam.tracking.search import OdometrySearch
from gridslam.tracking.tracker import Tracker, TrackerState
from gridslam.types import Beams, FloatArray, MotionSampler, Odometry

_LOCAL_MAPS = OccupancyGridMapping()
"""Makes the local maps of the tracker."""

_TRACKED_VARIANCES = np.square([0.03, 0.03, 0.02])
"""Of the tracked motion between two updates, in x, y and theta: half a cell, and its angle at a distance of 1.5 m."""


@final
class TrackedMotion(NamedTuple):
    """The tracker, and its estimate at the last update of the particles.

    Attributes
    ----------
    tracker : TrackerState
        Changed in place by each scan.
    pose_at_update : Pose
        The tracker's pose at the last update.
    replaces_odometry : bool
        Whether the odometry since the last update was rejected at the last scan.
    """

    tracker: TrackerState
    pose_at_update: Pose
    replaces_odometry: bool = False

    def snapshot(self) -> TrackedMotion:
        """Keep a copy for later, at the cost of the tables of the local maps."""
        return self._replace(tracker=self.tracker.snapshot())


@final
@parameters(frozen=True)
class OdometryCheck:
    """Compares the odometry with the motion from scan to scan, and replaces it where they contradict each other.

    The tracker of SLAM matches each scan to the ones before. If the motion that it finds since the last update is
    improbable by the filter's own motion model, p(x_t | u_t, x_t-1), or if the tracker no longer trusts the odometry,
    the particles move by the tracked motion. Such odometry counts reverse motion as forward, freezes, or was reset.
    Otherwise they move by the odometry, whose errors are independent of the scans that weigh them. So they do where
    scans are so far apart that the tracker itself depends on the odometry.

    Parameters
    ----------
    tracker : Tracker
        As in SLAM, but that two scans a second are not sparse: a known map corrects what it errs by, and the odometry
        is there to be checked.
    gate : float, > 0
        Squared Mahalanobis distance between both motions above which the odometry is rejected. The default is the
        quantile of 99.9 % of chi-square with three degrees of freedom.
    """

    tracker: Tracker = Tracker(search=OdometrySearch(sparse_period_s=0.6))
    gate: float = bounded(16.27, gt=0)

    def track(self, tracked: TrackedMotion | None, odometry: Odometry | None, beams: Beams) -> TrackedMotion:
        """Track one scan; updates the tracker in place."""
        stamp_ns = beams.scan.stamp_ns
        if tracked is None:
            tracker = self.tracker.init(odometry, stamp_ns, beams, _LOCAL_MAPS)
            return TrackedMotion(tracker, tracker.pose)
        self.tracker.step(tracked.tracker, odometry, stamp_ns, beams)
        return tracked

    def __call__(
        self, tracked: TrackedMotion, measured: FloatArray, motion: Callable[[FloatArray], MotionSampler]
    ) -> tuple[TrackedMotion, FloatArray]:
        """Return motion (3,) since the last update: as `measured` (3,) by the odometry, or as tracked.

        Parameters
        ----------
        motion : callable
            The motion model: conditions the motion on an increment (3,) of the odometry.
        """
        tracker = tracked.tracker
        found = np.array(between(tracked.pose_at_update, tracker.pose))
        replaces = not self.tracker.search.is_sparse(tracker) and (
            not tracker.odometry_errors.trusted or self._contradicts(found, measured, motion)
        )
        return tracked._replace(replaces_odometry=replaces), found if replaces else measured

    def _contradicts(
        self, found: FloatArray, measured: FloatArray, motion: Callable[[FloatArray], MotionSampler]
    ) -> bool:
        """Return whether tracked motion (3,) is improbable given the odometry."""
        apart = wrap_headings(found - measured)
        if apart @ (apart / _TRACKED_VARIANCES) <= self.gate:  # so it is the more with the noise of the odometry
            return False
        noise = motion(measured).moments(np.zeros((1, 3)))[1][0]
        return bool(apart @ np.linalg.solve(noise + np.diag(_TRACKED_VARIANCES), apart) > self.gate)
