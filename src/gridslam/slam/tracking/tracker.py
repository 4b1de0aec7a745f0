"""The tracker: matches every scan to a sliding local map and outputs smooth laser odometry.

It uses only its local maps, so it drifts slowly and never jumps at loop closures. The particles take its increments as
their control (Haehnel et al. 2003). Without odometry it predicts by the robot's velocity, and searches more
widely.
"""

from __future__ import annotations

import math
from typing import Annotated, final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import Pyramid
from gridslam.matching.gauss_newton import EVALUATE_ONLY, GaussNewton, degenerate_direction
from gridslam.models.parameters import Kind
from gridslam.slam.tracking.deskew import TrackerDeskew
from gridslam.slam.tracking.motion import motion_of, odometry_sigmas
from gridslam.slam.tracking.odometry_calibration import OdometryCalibration
from gridslam.slam.tracking.search import OdometrySearch
from gridslam.slam.tracking.state import (
    PoseEstimate,
    Prediction,
    SensorTrack,
    TrackedScan,
    TrackerState,
    is_within,
    pose_of,
)
from gridslam.slam.tracking.velocity import ConstantVelocity
from gridslam.types import BeamEnds, Beams, FloatArray, Match, Odometry

__all__ = ["TrackedScan", "Tracker", "TrackerState"]

_NO_PRIOR = np.full((1, 3, 3), 1e-9) * np.eye(3)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class Tracker:
    """Matches every scan to the older of two alternating local maps.

    Parameters
    ----------
    standstill_m, standstill_rad : float
        A scan after less odometry than both takes the odometry, unless fewer of its beams agree than before: there is
        nothing to learn from it. Without odometry the robot stands while its matches stay within both.
    insert_m, insert_rad : float
        A scan is inserted after this much motion.
    map_scans : int
        Number of scans of each laser in a local map after which the second one is begun; when that is as full, it
        replaces the first.
    beam_sigma_m : float, m
        Standard deviation of a beam's distance to the map against which the odometry's information is weighed. Far
        below a lidar's noise: beams are many, and wheel slip is not covered by any variance. With seven times as
        much the Intel log is lost by 0.2 m and more.
    jump_m, jump_rad : float
        Odometry that moves farther between two scans than this and the speeds in `velocity` allow has jumped: it was
        reset, or a message was lost. Its increment is not used, as if there had been no odometry.
    min_inlier_ratio : float
        Minimum inlier ratio of a match; below it (mostly unmapped area, or a turn too fast for the scan rate) the
        prediction is used.
    slip_m : float, m
        A match that moves the position farther than this from the odometry, and than four of the odometry's standard
        deviations, requires a gain in inliers (`slip_gain`): wheel slip or delayed odometry. Else something misled it
        (a person walking along, the dotted far end of a bare corridor, a scan smeared by a fast turn): the position
        keeps the odometry, and only the heading is taken.
    slip_inlier_gain : float
        Minimum gain of the inlier ratio by such a match.
    matcher : GaussNewton
        How a scan is matched.
    calibrated_matcher : GaussNewton
        The same once the odometry is calibrated: it then constrains weak directions better than the scan. Where
        directions are better determined than that, the odometry's errors are learned.
    velocity : ConstantVelocity
        Motion prediction without odometry.
    merge_max_m, merge_max_rad : float
        A scan is matched together with what the other lasers saw last, from no farther away than both by the odometry;
        where there is none, from a twentieth of that.
    search_inlier_ratio : float
        Inlier ratio of a match below which a better one is searched for from the velocity's
        prediction and all around: on real logs more agree in the right place, and fewer in others.
    max_unmatched_scans : int
        Without odometry, a scan is inserted without a valid match after this many consecutive failures.
    search : OdometrySearch
        How a scan is searched for around the odometry where scans are far apart.
    deskew : TrackerDeskew or None
        How scans with beam times are deskewed; None: they are taken as they are.
    calibration : OdometryCalibration or None
        Online calibration of the odometry; None: disabled.
    """

    standstill_m: float = Field(default=0.005, ge=0)
    standstill_rad: float = Field(default=0.005, ge=0)
    insert_m: float = Field(default=0.2, gt=0)
    insert_rad: float = Field(default=0.1, gt=0)
    map_scans: int = Field(default=20, ge=1)
    beam_sigma_m: float = Field(default=0.0016, gt=0)
    jump_m: float = Field(default=1.0, gt=0)
    jump_rad: float = Field(default=1.0, gt=0)
    min_inlier_ratio: float = Field(default=0.5, ge=0, le=1)
    slip_m: float = Field(default=0.08, gt=0)
    slip_inlier_gain: float = Field(default=0.1, ge=0, le=1)
    matcher: GaussNewton = GaussNewton()
    calibrated_matcher: GaussNewton = GaussNewton(min_information=0.05)
    velocity: ConstantVelocity = ConstantVelocity()
    merge_max_m: float = Field(default=0.3, ge=0)
    merge_max_rad: float = Field(default=0.3, ge=0)
    search_inlier_ratio: float = Field(default=0.7, ge=0, le=1)
    max_unmatched_scans: int = Field(default=3, ge=1)
    search: OdometrySearch = OdometrySearch()
    deskew: Annotated[TrackerDeskew | None, Kind()] = TrackerDeskew()
    calibration: Annotated[OdometryCalibration | None, Kind()] = OdometryCalibration()

    def init(
        self, odometry: Odometry | None, stamp_ns: int, beams: Beams, mapper: OccupancyGridMapping
    ) -> TrackerState:
        """Start at the origin of the tracker's frame with the first scan."""
        state = TrackerState.start(mapper.empty(2), odometry, stamp_ns, beams.scan.sensor)
        state.maps.update(state.row, state.pose[None], beams)
        return state

    def step(self, state: TrackerState, odometry: Odometry | None, stamp_ns: int, beams: Beams) -> TrackedScan:
        """Track one scan; updates `state`."""
        at, seconds = pose_of(odometry), self.velocity.seconds(state, stamp_ns)
        predicted, spread = self._predict(state, at, stamp_ns, seconds), state.velocity_variances
        if self.deskew is None or beams.scan.beam_times_s is None:
            found = self._locate(state, predicted, beams)
        else:
            found, beams = self.deskew(
                state, predicted, lambda pose: self.velocity.update_twist(state, pose, seconds), beams,
                lambda sharp: self._locate(state, predicted, sharp),
            )  # fmt: skip
        joint = self._merge_lasers(state, found.pose, found.prediction, beams)
        self._advance(state, found)
        state.rejected_odometry += odometry is not None and not found.prediction.by_odometry
        if found.matched or not found.prediction.by_odometry:
            state.matched_pose, state.matched_odometry = found.pose, at
        state.stamp_ns, state.odometry = stamp_ns, at
        if found.matched:
            self._learn(state, found)
            self._insert(state, found, beams)
        if not found.prediction.by_odometry:
            return TrackedScan(found.pose, found.prediction.pose, beams, joint, spread)
        control, widening = self.search.control(state, found)
        return TrackedScan(found.pose, control, beams, joint, widening)

    def _predict(self, state: TrackerState, at: FloatArray, stamp_ns: int, seconds: float) -> Prediction:
        measured = between(state.matched_odometry, at)
        useless = not (state.odometry_errors.trusted or self.search.is_sparse(state))  # else velocities are worse
        if math.isnan(measured[0]) or useless or self._has_jumped(state, at, stamp_ns):
            return self._predict_by_velocity(state, seconds)
        increment = state.odometry_errors.correct_increment(measured)
        moved, turned = motion_of(increment)
        sigmas = odometry_sigmas(moved, turned, state.maps.resolution_m)
        pose = compose(state.matched_pose, increment)
        return Prediction(pose, True, seconds, moved, turned, *sigmas, self.beam_sigma_m)

    def _predict_by_velocity(self, state: TrackerState, seconds: float) -> Prediction:
        velocity = self.velocity
        pose, sigmas = velocity.predict(state, seconds), velocity.sigmas(seconds)
        turned = abs(float(state.twist[2])) * seconds
        return Prediction(pose, False, seconds, 0.0, turned, *sigmas, velocity.beam_sigma_m)

    def _has_jumped(self, state: TrackerState, at: FloatArray, stamp_ns: int) -> bool:
        dx, dy, turn = (at - state.odometry).tolist()
        seconds = abs(stamp_ns - state.stamp_ns) * 1e-9
        far = math.hypot(dx, dy) > self.jump_m + self.velocity.speed_mps * seconds
        return far or abs(math.remainder(turn, math.tau)) > self.jump_rad + self.velocity.turn_rps * seconds

    def _locate(self, state: TrackerState, predicted: Prediction, beams: Beams) -> PoseEstimate:
        """Where a scan was taken."""
        track = state.sensors.get(beams.scan.sensor)
        if track is None:  # the other lasers may look elsewhere
            return PoseEstimate(predicted.pose, predicted, matched=len(beams) > 0, lost=False)
        joint = self._merge_lasers(state, predicted.pose, predicted, beams)
        if not len(beams) or len(joint) < self.matcher.min_beams:
            return PoseEstimate(predicted.pose, predicted, matched=False, lost=not predicted.by_odometry)
        if not predicted.by_odometry:
            return self._match_from_velocity(state, predicted, joint)
        if self._is_standing(state, track, predicted, joint):
            return PoseEstimate(predicted.pose, predicted, matched=False, lost=False)
        found = self._match_from_odometry(state, predicted, joint)
        if found.inlier_ratio < self.search_inlier_ratio:  # it may be the odometry that is wrong: a reading came late
            other = self._locate_by_search(state, predicted, joint)
            is_better = other.inlier_ratio - found.inlier_ratio > self.slip_inlier_gain
            found = other if is_better and other.inlier_ratio >= self.search_inlier_ratio else found
        return found

    def _locate_by_search(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Search around the velocity's prediction; around that of the odometry if the velocity is invalid."""
        if self.search.is_far_from_last(state, predicted):
            return self.search(state, predicted, beams)
        return self._match_from_velocity(state, self._predict_by_velocity(state, predicted.seconds), beams)

    def _merge_lasers(self, state: TrackerState, pose: FloatArray, predicted: Prediction, beams: Beams) -> BeamEnds:
        """The scan, taken at about `pose`, with those of the other lasers."""
        trusted = 1.0 if predicted.by_odometry else 0.05
        return state.merge_lasers(beams, pose, trusted * self.merge_max_m, trusted * self.merge_max_rad)

    def _is_standing(self, state: TrackerState, track: SensorTrack, predicted: Prediction, beams: BeamEnds) -> bool:
        """Whether the robot has not moved according to the odometry, and the scan does not contradict it."""
        if not is_within(track.matched_pose, predicted.pose, self.standstill_m, self.standstill_rad):
            return False
        ratio = EVALUATE_ONLY(state.maps, state.row, predicted.pose[None], _NO_PRIOR, beams).score[0] / len(beams)
        return bool(ratio > track.inlier_ratio - self.slip_inlier_gain)

    def _match_from_odometry(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Match from a prediction by odometry; where a match is implausible, only its heading is taken."""
        known = self.calibration is not None and self.calibration.is_known(state.odometry_errors)
        matcher = self.calibrated_matcher if known else self.matcher
        match = matcher(state.maps, state.row, predicted.pose[None], predicted.prior, beams)
        best, score = match.poses[0], float(match.score[0])
        pose = best
        if score < self.min_inlier_ratio * len(beams):
            return PoseEstimate(predicted.pose, predicted, matched=True, lost=True)
        away = math.hypot(pose[0] - predicted.pose[0], pose[1] - predicted.pose[1])
        if away > max(self.slip_m, 4 * predicted.sigma_m):
            stayed = np.array([predicted.pose[0], predicted.pose[1], pose[2]])
            before = EVALUATE_ONLY(state.maps, state.row, stayed[None], _NO_PRIOR, beams).score[0]
            pose = pose if score - float(before) > self.slip_inlier_gain * len(beams) else stayed
        determined = pose is best and self._is_determined(match)
        return PoseEstimate(
            pose, predicted, matched=True, lost=False, inlier_ratio=score / len(beams), determined=determined
        )

    def _match_from_velocity(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Match from a prediction by the velocity; where few beams agree, search all around it."""
        maps, row, count = state.maps, state.row, len(beams)
        match = self.matcher(maps, row, predicted.pose[None], predicted.prior, beams)
        if match.score[0] < self.search_inlier_ratio * count:
            search = self.velocity.search(state, predicted.seconds)
            place = search.search(Pyramid.of(maps, state.matched_map), predicted.pose, None, beams.ends)
            if place is not None:
                other = self.matcher(maps, row, place.pose[None], _NO_PRIOR, beams)
                convinces = other.score[0] - match.score[0] > self.slip_inlier_gain * count
                match = other if convinces and other.score[0] >= self.search_inlier_ratio * count else match
        if match.score[0] < self.min_inlier_ratio * count:
            return PoseEstimate(predicted.pose, predicted, matched=True, lost=True)
        pose, score = match.poses[0], float(match.score[0])
        stands = is_within(state.pose, pose, self.standstill_m, self.standstill_rad)
        determined = self._is_determined(match)
        return PoseEstimate(state.pose if stands else pose, predicted, True, False, score / count, determined)

    def _advance(self, state: TrackerState, found: PoseEstimate) -> None:
        """Move on; where nothing is known of the motion, the robot is thought to come to rest."""
        predicted = found.prediction
        if found.lost or self.search.had_blind_gap(state, predicted):
            state.rejected_match_m2 += predicted.sigma_m**2
            state.rejected_match_rad2 += predicted.sigma_rad**2
        moved, turned = motion_of(between(state.pose, found.pose))
        if moved + turned > self.standstill_m + self.standstill_rad:
            state.mean_step += 0.05 * (min(moved + turned, self.search.blind_step) - state.mean_step)
        blind = found.lost and not predicted.by_odometry
        state.twist = 0.5 * state.twist if blind else self.velocity.update_twist(state, found.pose, predicted.seconds)
        if found.inlier_ratio and not predicted.by_odometry:
            state.velocity_variances = self.velocity.update_variances(
                state.velocity_variances, between(predicted.pose, found.pose)
            )
        state.unlocalized_scans = state.unlocalized_scans + 1 if blind else 0
        state.pose = found.pose

    def _learn(self, state: TrackerState, found: PoseEstimate) -> None:
        """Learn what the odometry's errors are, from where the scan was taken."""
        if self.calibration is not None:
            is_good_match = found.inlier_ratio >= self.search_inlier_ratio
            self.calibration.learn(state.odometry_errors, found.pose, state.odometry, is_good_match, found.determined)

    def _is_determined(self, match: Match) -> bool:
        """Whether a match is non-degenerate, and better than calibrated odometry."""
        least = self.calibrated_matcher.min_information
        return degenerate_direction(match.information[0], float(match.score[0]), least) is None

    def _insert(self, state: TrackerState, found: PoseEstimate, beams: Beams) -> None:
        """Insert the scan if its laser has moved since its last one, and if one knows where it was taken."""
        track = state.sensors.get(beams.scan.sensor)
        state.stamps_unreliable = state.stamps_unreliable or (
            track is not None and self.velocity.are_stamps_unreliable(track, state.stamp_ns, found.pose)
        )
        due = track is None or not is_within(track.inserted_pose, found.pose, self.insert_m, self.insert_rad)
        if found.lost and found.prediction.by_odometry:  # smeared by a turn, or seen at another time than the stamp's
            due = due and (
                self.search.is_far_from_last(state, found.prediction) or found.prediction.turned_rad <= self.insert_rad
            )
        elif found.lost:  # what is seen is new, but one scan does not decide that
            due = state.unlocalized_scans >= self.max_unmatched_scans
        last = track or SensorTrack.first(state.stamp_ns, found.pose)
        ends = beams.ends if len(state.sensors) > 1 else last.ends
        last = last._replace(
            stamp_ns=state.stamp_ns, matched_pose=found.pose, inlier_ratio=found.inlier_ratio, ends=ends
        )
        state.update_track(beams.scan.sensor, last._replace(inserted_pose=found.pose) if due else last)
        if due:
            state.insert(beams, self.map_scans)
