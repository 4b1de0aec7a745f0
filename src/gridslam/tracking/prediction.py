"""Where the next scan should be taken: by the odometry, or by the velocity where there is none."""

from __future__ import annotations

import math
from typing import NamedTuple, final

from gridslam.geometry.single_pose import UNKNOWN_POSE, Information, Pose, between, compose, exp, log, motion_of
from gridslam.matching.branch_and_bound import BranchAndBound
from gridslam.parameters import bounded, parameters
from gridslam.tracking.odometry_calibration import MIN_SEGMENTS
from gridslam.tracking.state import SensorTrack, TrackerState

MAX_INTERVAL_S = 1.0
"""Longer than this no velocity lasts: a gap in the log counts as this long."""

_SMOOTHING_S = 0.05
"""The velocity is that of the last scans, back to about this time: two scans at nearly the same stamp, of two lasers,
do not determine it."""

_MARGIN_M = 0.05
_MARGIN_RAD = 0.05
"""Matches of scans at one stamp may be so far apart."""

_SEARCH_M = 0.5
_SEARCH_RAD = 0.5
"""A scan is searched for within this of the prediction, and what the speeds allow beyond it."""

_SIGMA_M = 0.005
_SIGMA_RAD = 0.01
"""Standard deviations of a prediction for the stamp of the last scan, which another laser may have."""

_SIGMA_MPS = 0.2
_SIGMA_RPS = 1.5
"""What they grow by with time, m/s and rad/s. On logs of 5 scans a second, 95 of 100 predictions are within 6 cm and
0.1 rad."""

_BEAM_SIGMA_M = 0.03
"""Standard deviation of a beam against which a prediction by the velocity is weighed: a lidar's. Unlike wheels, mass
does not slip."""

_CELL_SIGMA_M = 0.05
"""Standard deviation of a beam in a map of cells of 5 cm, where few of them determine a direction."""

_RANDOM_WALK_M = 2.0
"""Way beyond which errors of calibrated odometry do not add up, as its systematic ones are known."""

NEWEST_WEIGHT = 0.05
"""Weight of the newest scan in a running mean."""


@final
class Prediction(NamedTuple):
    """Predicted pose of a scan."""

    pose: Pose
    by_odometry: bool  # or by the velocity
    seconds: float  # since the last scan
    moved_m: float  # since the last scan that was matched, by the odometry; 0 without
    turned_rad: float  # since the last scan that was matched
    sigma_m: float
    sigma_rad: float
    beam_sigma_m: float  # that of a beam, against which the prediction is weighed
    reading: Pose = UNKNOWN_POSE  # of the odometry, by which it was predicted

    @property
    def prior(self) -> Information:
        """Information of the prediction, beside residuals in m."""
        position = (self.beam_sigma_m / self.sigma_m) ** 2
        heading = (self.beam_sigma_m / self.sigma_rad) ** 2
        return position, 0.0, 0.0, position, 0.0, heading

    @property
    def calibrated_prior(self) -> Information:
        """The same of calibrated odometry: few beams, such as see a corridor's length, do not outweigh its position."""
        position = (_CELL_SIGMA_M / self.sigma_m) ** 2
        return (position, 0.0, 0.0, position, 0.0, self.prior[5])


@final
class PoseEstimate(NamedTuple):
    """Where a scan was taken."""

    pose: Pose
    prediction: Prediction  # from which it was found
    matched: bool  # whether the map was asked
    lost: bool  # neither match nor prediction is reliable
    inlier_ratio: float = 0.0  # of the beams that agree with the map; 0 if the match is rejected
    determined: bool = False  # by the scan, in all directions
    open_direction: tuple[float, float] | None = None  # unit vector along which the prediction was kept; None: no such


def predict_by_odometry(
    state: TrackerState, last: Pose, last_reading: Pose, reading: Pose, seconds: float, beam_sigma_m: float
) -> Prediction:
    """Predict the pose of a scan with a reading of the odometry from those of an earlier scan.

    The standard deviations grow with the motion, from a tenth of a cell on; with the root of a way beyond
    `_RANDOM_WALK_M`, where the systematic errors of the odometry are known.
    """
    increment = state.odometry_errors.correct_increment(between(last_reading, reading))
    pose = compose(last, increment)
    moved_m, turned_rad = motion_of(increment)
    cell_m = state.maps.resolution_m
    way_m = moved_m
    if state.odometry_errors.segments >= MIN_SEGMENTS:
        way_m = min(moved_m, math.sqrt(_RANDOM_WALK_M * moved_m))
    sigma_m = 0.1 * cell_m + 0.15 * way_m + 0.5 * cell_m * turned_rad
    sigma_rad = 0.003 + 0.05 * turned_rad + 0.04 * way_m
    return Prediction(pose, True, seconds, moved_m, turned_rad, sigma_m, sigma_rad, beam_sigma_m, reading)


def unmatched_variances(state: TrackerState, predicted: Prediction) -> tuple[float, float]:
    """Return the variances (m^2, rad^2) of a predicted motion that no match has measured.

    It is at least as uncertain as the odometry was found to be.
    """
    learned_m2, learned_rad2 = state.odometry_errors.variances_of(predicted.moved_m, predicted.turned_rad)
    return max(predicted.sigma_m**2, learned_m2), max(predicted.sigma_rad**2, learned_rad2)


@final
@parameters(frozen=True)
class ConstantVelocity:
    """Keeps the robot's velocity, and predicts by it where there is no odometry.

    Parameters
    ----------
    speed_mps, turn_rps : float
        Above what the robot drives (m/s, rad/s); the defaults are for indoor robots.
    """

    speed_mps: float = bounded(3.0, ge=0, le=1000)
    turn_rps: float = bounded(3.0, ge=0, le=1000)

    def seconds(self, state: TrackerState, stamp_ns: int) -> float:
        """Time from the last scan to one at `stamp_ns`, >= 0, as far as stamps are to be trusted."""
        passed = min(max(1e-9 * (stamp_ns - state.stamp_ns), -MAX_INTERVAL_S), MAX_INTERVAL_S)
        state.period_s += NEWEST_WEIGHT * (passed - state.period_s)
        return state.interval_s if state.stamps_unreliable else max(passed, 0.0)

    def search(self, state: TrackerState, seconds: float) -> BranchAndBound:
        """Where the robot may be after `seconds`: as far as it can have come since something was known of it."""
        passed = seconds * (1 + state.unlocalized_scans)
        return BranchAndBound(
            window_m=min(_SEARCH_M + self.speed_mps * passed, 6 * _SEARCH_M),
            window_rad=min(_SEARCH_RAD + self.turn_rps * passed, math.pi),
            min_score=0.6,
        )

    def predict(self, state: TrackerState, seconds: float) -> Prediction:
        """Predict the pose after `seconds` of the present velocity."""
        vx, vy, omega = state.twist
        pose = compose(state.pose, exp((seconds * vx, seconds * vy, seconds * omega)))
        turned = abs(omega) * seconds
        sigmas = _SIGMA_M + _SIGMA_MPS * seconds, _SIGMA_RAD + _SIGMA_RPS * seconds
        return Prediction(pose, False, seconds, 0.0, turned, *sigmas, _BEAM_SIGMA_M)

    def exceeds(self, a: Pose, b: Pose, seconds: float, margin_m: float, margin_rad: float) -> bool:
        """Return whether poses are farther apart than the margins and the way that the robot drives in `seconds`."""
        far = math.hypot(b[0] - a[0], b[1] - a[1]) > margin_m + self.speed_mps * seconds
        return far or abs(math.remainder(b[2] - a[2], math.tau)) > margin_rad + self.turn_rps * seconds

    def update_twist(self, twist: Pose, increment: Pose, seconds: float) -> Pose:
        """Velocity once the base has moved by `increment`, `seconds` after the last scan: a running mean.

        The mean of increments over the time they took, in which the older ones count less, as exp(-age / smoothing) to
        first order; it is safe for any `seconds`, 0 included.
        """
        dx, dy, turn = log(increment)
        vx, vy, omega = twist
        whole = _SMOOTHING_S + seconds
        return (_SMOOTHING_S * vx + dx) / whole, (_SMOOTHING_S * vy + dy) / whole, (_SMOOTHING_S * omega + turn) / whole

    def are_stamps_unreliable(self, track: SensorTrack, stamp_ns: int, pose: Pose) -> bool:
        """Whether a laser's stamps cannot be true, as its scan at `stamp_ns` was taken from `pose`.

        They go backward, or the robot went too far: the scans were stamped when they arrived, in bursts, or the clock
        is coarse. The order of the scans is the true one all the same.
        """
        passed = 1e-9 * (stamp_ns - track.stamp_ns)
        return passed < 0 or self.exceeds(track.matched_pose, pose, passed, _MARGIN_M, _MARGIN_RAD)

    def update_variances(self, before: tuple[float, float], missed: Pose) -> tuple[float, float]:
        """Variances of predictions, m^2 and rad^2, of which the last one missed by the increment `missed`."""
        x, y, turn = missed
        position, heading = before
        return (
            position + NEWEST_WEIGHT * (min(0.5 * (x * x + y * y), 9 * position) - position),
            heading + NEWEST_WEIGHT * (min(turn * turn, 9 * heading) - heading),
        )
