"""The tracker: matches every scan to a sliding local map and outputs smooth laser odometry.

It uses only its local maps, so it drifts slowly and never jumps at loop closures. The particles take its increments as
their control (Haehnel et al. 2003). Without odometry it predicts by the robot's velocity, and searches more
widely.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, final

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.single_pose import Pose, as_pose, between, compose, is_known, is_within, motion_of
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import (
    EVALUATE_ONLY,
    NO_INFORMATION,
    GaussNewton,
    PoseMatch,
    judged_inlier_ratio,
    known_inlier_ratio,
)
from gridslam.parameters import Kind, bounded, parameters
from gridslam.tracking.odometry_calibration import OdometryCalibration
from gridslam.tracking.prediction import (
    NEWEST_WEIGHT,
    ConstantVelocity,
    PoseEstimate,
    Prediction,
    predict_by_odometry,
    unmatched_variances,
)
from gridslam.tracking.recent_scans import SURFACE_SCANS
from gridslam.tracking.search import OdometrySearch, calibrated, local_pyramid
from gridslam.tracking.state import Control, SensorTrack, TrackedScan, TrackerState, pose_of
from gridslam.types import BeamEnds, Beams, FloatArray, Odometry

__all__ = ["OdometryTracker", "TrackedScan", "Tracker", "TrackerState"]

_JUMP_M = 1.0
_JUMP_RAD = 1.0
"""Odometry that moves farther between two scans than this and the robot's speeds allow has jumped: it was reset, or a
message was lost. Its increment is not used, as if there had been no odometry."""

_MERGE_M = 0.3
_MERGE_RAD = 0.3
"""A scan is matched together with what the other lasers saw last, from no farther away than both by the odometry; where
there is none, from a twentieth of that."""

_SLIP_SIGMAS = 4.0
"""Standard deviations of calibrated odometry beyond which a match needs a gain in inliers."""

_SLIP_INLIER_GAIN = 0.1
"""Minimum gain of the inlier ratio by a match farther from the odometry than `slip_m`: more beams than noise and people
move. It is needed at the limit; the farther a match is from calibrated odometry the greater the gain must be, in
proportion to the Cauchy log likelihood of that error."""

_MATCHED_TURN_RAD = 0.2
"""A scan within which the robot turned by half as much more than it was corrected for is still matched."""

_MANY_BEAMS = 100
"""Beams from which on those that end in known cells, some tens then, decide: a few fit in many places."""

_SURFACES_M = 0.4
_SURFACES_RAD = 0.2
"""Scans to whose surfaces later ones are matched are farther apart than one of these: nearer ones add cost alone."""

_MAX_UNMATCHED_SCANS = 3
"""Without odometry, a scan is inserted without a valid match after this many consecutive failures."""


@final
@checked
@parameters(frozen=True)
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
        much the Intel log is lost by 0.2 m and more. Once the odometry is calibrated its position weighs more, see
        `Prediction.calibrated_prior`.
    min_inlier_ratio : float
        Minimum inlier ratio of a match; below it (mostly unmapped area, or a turn too fast for the scan rate) the
        prediction is used.
    search_inlier_ratio : float
        Inlier ratio of a match below which a better one is searched for from the velocity's
        prediction and all around: on real logs more agree in the right place, and fewer in others. It must reach this
        ratio, too; between scans that are far apart, where else none would be matched, the least of a match will do.
    slip_m : float, m
        A match that moves the position farther than this from the odometry, and than four of the odometry's standard
        deviations, requires a gain in inliers: wheel slip or delayed odometry. Else something misled it (a person
        walking along, the dotted far end of a bare corridor, a scan smeared by a fast turn): the position keeps the
        odometry, and only the heading is taken.
    deskew : bool
        Whether scans with beam times are deskewed, by the motion that their match yields and in the order of the beams
        that fits the map best; else they are taken as they are.
    matcher : GaussNewton
        How a scan is matched. Once the odometry is calibrated it constrains weak directions better than the scan.
    velocity : ConstantVelocity
        Motion prediction without odometry.
    search : OdometrySearch
        How a scan is searched for around the odometry where scans are far apart.
    calibration : OdometryCalibration or None
        Online calibration of the odometry; None: disabled.
    """

    standstill_m: float = bounded(0.005, ge=0, le=1e6)
    standstill_rad: float = bounded(0.005, ge=0, le=100)
    insert_m: float = bounded(0.2, ge=1e-6, le=1e6)
    insert_rad: float = bounded(0.1, ge=1e-6, le=100)
    map_scans: int = bounded(20, ge=1, le=1_000_000)
    beam_sigma_m: float = bounded(0.0016, ge=1e-6, le=100)
    min_inlier_ratio: float = bounded(0.5, ge=0, le=1)
    search_inlier_ratio: float = bounded(0.7, ge=0, le=1)
    slip_m: float = bounded(0.08, ge=1e-6, le=1e6)
    deskew: bool = True
    matcher: GaussNewton = GaussNewton()
    velocity: ConstantVelocity = ConstantVelocity()
    search: OdometrySearch = OdometrySearch()
    calibration: Annotated[OdometryCalibration | None, Kind()] = OdometryCalibration()

    def init(
        self, odometry: Odometry | None, stamp_ns: int, beams: Beams, mapper: OccupancyGridMapping
    ) -> TrackerState:
        """Start at the origin of the tracker's frame with the first scan."""
        state = TrackerState.start(mapper.empty(2), odometry, stamp_ns, beams.scan.sensor)
        state.maps.update(state.row, np.array([state.pose]), beams)
        self._remember(state, beams)
        return state

    def step(
        self,
        state: TrackerState,
        odometry: Odometry | None,
        stamp_ns: int,
        beams: Beams,
    ) -> TrackedScan:
        """Track one scan; updates `state`."""
        reading = pose_of(odometry)
        seconds = self.velocity.seconds(state, stamp_ns)
        predicted = self._predict(state, reading, stamp_ns, seconds)
        spread = state.velocity_variances
        if predicted.by_odometry:  # which is better than what may move by itself
            beams = beams.without_movable()
        if self.deskew and beams.scan.beam_times_s is not None:
            found, beams = self._locate_deskewed(state, predicted, beams)
        else:
            found = self._locate(state, predicted, beams)
        if found.inlier_ratio and found.pose != state.pose and len(state.sensors) == 1:
            found = found._replace(pose=state.recent.match(beams.ends, found.pose))
        joint = self._merge_lasers(state, found.pose, found.prediction, beams)
        self._advance(state, found)
        by_odometry = found.prediction.by_odometry
        state.rejected_odometry += odometry is not None and not by_odometry
        if (found.matched and by_odometry) or not predicted.by_odometry:
            state.matched_pose = found.pose
            state.matched_odometry = reading
        state.stamp_ns = stamp_ns
        state.odometry = reading
        if found.matched:
            self._learn(state, found)
            self._insert(state, found, beams)
        by_velocity = Control(found.pose, spread if found.lost else None)
        control = self.search.control(state, found) if by_odometry else by_velocity
        return TrackedScan(found.pose, found.prediction.pose, control, beams, joint)

    def _predict(self, state: TrackerState, odometry: Pose, stamp_ns: int, seconds: float) -> Prediction:
        pose, last = state.matched_pose, state.matched_odometry
        if self._contradicts_odometry(state):
            pose, last = state.pose, state.odometry
        useless = not (state.odometry_errors.trusted or self.search.is_sparse(state))  # else velocities are worse
        passed = abs(stamp_ns - state.stamp_ns) * 1e-9
        jumped = self.velocity.exceeds(state.odometry, odometry, passed, _JUMP_M, _JUMP_RAD)
        if not (is_known(last) and is_known(odometry)) or useless or jumped:
            return self.velocity.predict(state, seconds)
        return predict_by_odometry(state, pose, last, odometry, seconds, self.beam_sigma_m)

    def _contradicts_odometry(self, state: TrackerState) -> bool:
        """Whether the last scan was found where the odometry did not lead: wheels slip, and readings come late."""
        if state.odometry == state.matched_odometry or not is_known(state.odometry):
            return False
        increment = state.odometry_errors.correct_increment(between(state.matched_odometry, state.odometry))
        led_to = compose(state.matched_pose, increment)
        return not is_within(led_to, state.pose, self.standstill_m, self.standstill_rad)

    def _locate_deskewed(self, state: TrackerState, predicted: Prediction, beams: Beams) -> tuple[PoseEstimate, Beams]:
        """Find where a scan with beam times was taken, and how its beams are seen from there at its stamp.

        A scan goes on after its stamp, so its beams depend on the following twist: that of the motion up to the stamp,
        by the prediction or by the match, or that one grown by as much as since the scan before; where a prediction by
        the velocity fails, that of a sudden turn. The one by which most beams agree with the map is taken. `state`
        learns the order of the beams.
        """
        track = state.sensors.get(beams.scan.sensor)
        order = 1 if track is None else track.best_order
        deskewed = beams.deskew(order * self._twist_to(state, predicted.pose, predicted.seconds))
        best = self._locate(state, predicted, deskewed)

        def try_twists(*twists: FloatArray) -> None:
            nonlocal best, deskewed
            for twist in twists:
                again = beams.deskew(order * twist)
                found = self._locate(state, predicted, again)
                if found.inlier_ratio > best.inlier_ratio:
                    best, deskewed = found, again

        if not predicted.by_odometry and best.inlier_ratio < self.search_inlier_ratio:
            try_twists(*_sudden_turns(state.twist, beams, self.velocity.turn_rps))
        if not best.matched or not best.inlier_ratio:
            return best, deskewed
        twist = self._twist_to(state, best.pose, predicted.seconds)
        try_twists(twist, 2 * twist - np.array(state.twist))
        if track is not None:
            learned = track.beam_order.learn(
                beams, twist, lambda tried: self._locate(state, predicted, tried).inlier_ratio
            )
            state.update_track(beams.scan.sensor, track._replace(beam_order=learned))
        return best, deskewed

    def _twist_to(self, state: TrackerState, pose: Pose, seconds: float) -> FloatArray:
        """Velocity (3,) once the base is at `pose`, `seconds` after the last scan."""
        return np.array(self.velocity.update_twist(state.twist, between(state.pose, pose), seconds))

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
        if found.inlier_ratio >= self.search_inlier_ratio:
            return found
        needed, gain = self.search_inlier_ratio, _SLIP_INLIER_GAIN
        if self.search.is_far_from_last(state, predicted):
            other = self.search(state, predicted, joint, self.matcher)
            if found.lost and not self.search.had_blind_gap(state, predicted):
                needed = self.min_inlier_ratio  # the only place that the odometry allows
        else:  # it may be the odometry that is wrong: a reading came late
            other = self._match_from_velocity(state, self.velocity.predict(state, predicted.seconds), joint)
            gain = self._required_gain(state, predicted, other.pose)
        if self._contradicts_odometry(state):  # the last scan's reading came early or late, and this one is right
            before = (state.matched_pose, state.matched_odometry)
            led_to = predict_by_odometry(state, *before, predicted.reading, predicted.seconds, self.beam_sigma_m)
            again = self._match_from_odometry(state, led_to, joint)
            if again.inlier_ratio > other.inlier_ratio:
                other, gain = again, _SLIP_INLIER_GAIN
        return other if other.inlier_ratio >= max(needed, found.inlier_ratio + gain) else found

    def _required_gain(self, state: TrackerState, predicted: Prediction, pose: Pose) -> float:
        """Gain of the inlier ratio that a place needs that the odometry does not lead to; see `_SLIP_INLIER_GAIN`."""
        away = math.hypot(pose[0] - predicted.pose[0], pose[1] - predicted.pose[1])
        limit = self._slip_limit_m(predicted)
        if away <= limit or not self._is_calibrated(state):  # else the odometry may be wrong throughout
            return _SLIP_INLIER_GAIN
        return _SLIP_INLIER_GAIN * math.log1p((_SLIP_SIGMAS * away / limit) ** 2) / math.log1p(_SLIP_SIGMAS**2)

    def _slip_limit_m(self, predicted: Prediction) -> float:
        return max(self.slip_m, _SLIP_SIGMAS * predicted.sigma_m)

    def _is_calibrated(self, state: TrackerState) -> bool:
        return self.calibration is not None and self.calibration.is_known(state.odometry_errors)

    def _merge_lasers(self, state: TrackerState, pose: Pose, predicted: Prediction, beams: Beams) -> BeamEnds:
        """The scan, taken at about `pose`, with those of the other lasers."""
        trusted = 1.0 if predicted.by_odometry else 0.05
        return state.merge_lasers(beams, pose, trusted * _MERGE_M, trusted * _MERGE_RAD)

    def _is_standing(self, state: TrackerState, track: SensorTrack, predicted: Prediction, beams: BeamEnds) -> bool:
        """Whether the robot has not moved according to the odometry, and the scan does not contradict it."""
        if not is_within(track.matched_pose, predicted.pose, self.standstill_m, self.standstill_rad):
            return False
        ratio = _score(state, predicted.pose, beams) / len(beams)
        return ratio > track.inlier_ratio - _SLIP_INLIER_GAIN

    def _match_from_odometry(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Match from a prediction by odometry; where a match is implausible, only its heading is taken."""
        known = self._is_calibrated(state)
        matcher = calibrated(self.matcher) if known else self.matcher
        is_sparse = self.search.is_sparse(state)
        prior, thin_m = predicted.prior, 0.0
        if known and not is_sparse:
            prior, thin_m = predicted.calibrated_prior, matcher.cauchy_m
        match = matcher.match_pose(state.maps, state.matched_map, predicted.pose, prior, beams, thin_m)
        pose = match.pose
        count = len(beams)
        ratio = match.agreeing / count
        if ratio < self.min_inlier_ratio and count >= _MANY_BEAMS and not is_sparse:
            # much of what is seen may be new: after a wide turn, or of a narrow laser
            of_known = known_inlier_ratio(state.maps, state.row, np.array(pose), beams.ends, matcher.cauchy_m)
            ratio = of_known if of_known >= self.search_inlier_ratio else ratio
        if ratio < self.min_inlier_ratio:
            return PoseEstimate(predicted.pose, predicted, matched=True, lost=True)
        stayed = (predicted.pose[0], predicted.pose[1], pose[2])
        if math.hypot(pose[0] - predicted.pose[0], pose[1] - predicted.pose[1]) > self._slip_limit_m(predicted):
            gain = (match.agreeing - _score(state, stayed, beams)) / count
            if not known:  # once it is, the gain must grow with the distance; unknown cells indicate no slip
                agreed = [
                    judged_inlier_ratio(state.maps, state.row, np.array(it), beams, matcher.cauchy_m)
                    for it in (pose, stayed)
                ]
                gain = min(gain, agreed[0] - agreed[1])
            pose = pose if gain > self._required_gain(state, predicted, pose) else stayed
        direction = match.degenerate_direction(matcher.min_information)
        determined = direction is None and pose is not stayed and (known or self._is_determined(match))
        return PoseEstimate(pose, predicted, True, False, ratio, determined, direction)

    def _match_from_velocity(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> PoseEstimate:
        """Match from a prediction by the velocity; where few beams agree, search all around it."""
        count = len(beams)
        match = self.matcher.match_pose(state.maps, state.matched_map, predicted.pose, predicted.prior, beams)
        if match.score < self.search_inlier_ratio * count:
            search = self.velocity.search(state, predicted.seconds)
            place = search.search(local_pyramid(state), np.array(predicted.pose), None, beams.ends)
            if place is not None:
                found = as_pose(place.pose)
                other = self.matcher.match_pose(state.maps, state.matched_map, found, NO_INFORMATION, beams)
                convinces = other.score - match.score > _SLIP_INLIER_GAIN * count
                match = other if convinces and other.score >= self.search_inlier_ratio * count else match
        if match.score < self.min_inlier_ratio * count:
            return PoseEstimate(predicted.pose, predicted, matched=True, lost=True)
        pose = match.pose
        if is_within(state.pose, pose, self.standstill_m, self.standstill_rad):
            pose = state.pose
        direction = match.degenerate_direction(self.matcher.min_information)
        determined = direction is None and self._is_determined(match)
        return PoseEstimate(pose, predicted, True, False, match.score / count, determined, direction)

    def _advance(self, state: TrackerState, found: PoseEstimate) -> None:
        """Move on; where nothing is known of the motion, the robot is thought to come to rest."""
        predicted = found.prediction
        if found.lost or self.search.had_blind_gap(state, predicted):
            position_m2, heading_rad2 = unmatched_variances(state, predicted)
            state.unmatched = replace(
                state.unmatched,
                position_m2=state.unmatched.position_m2 + position_m2,
                heading_rad2=state.unmatched.heading_rad2 + heading_rad2,
            )
        self._accumulate_open_variance(state, found)
        increment = between(state.pose, found.pose)
        moved, turned = motion_of(increment)
        if moved + turned > self.standstill_m + self.standstill_rad:
            longest = max(2 * state.mean_step, self.search.blind_step)  # beyond is a gap
            state.mean_step += NEWEST_WEIGHT * (min(moved + turned, longest) - state.mean_step)
        blind = found.lost and not predicted.by_odometry
        if blind:
            vx, vy, omega = state.twist
            state.twist = 0.5 * vx, 0.5 * vy, 0.5 * omega
        else:
            state.twist = self.velocity.update_twist(state.twist, increment, predicted.seconds)
        if found.inlier_ratio and not predicted.by_odometry:
            state.velocity_variances = self.velocity.update_variances(
                state.velocity_variances, between(predicted.pose, found.pose)
            )
        state.unlocalized_scans = state.unlocalized_scans + 1 if blind else 0
        state.pose = found.pose

    @staticmethod
    def _accumulate_open_variance(state: TrackerState, found: PoseEstimate) -> None:
        """Add the variance of the prediction along the direction that a match left open."""
        direction = found.open_direction
        predicted = found.prediction
        if direction is None:
            state.open_way_m = 0.0
            return
        if predicted.by_odometry:
            variance = state.odometry_errors.variance_along(state.open_way_m, predicted.moved_m)
        else:
            variance = state.velocity_variances[0]
        state.open_way_m += predicted.moved_m
        x, y = direction
        added = variance * np.array([[x * x, x * y], [x * y, y * y]])
        state.unmatched = replace(state.unmatched, open_covariance=state.unmatched.open_covariance + added)

    def _learn(self, state: TrackerState, found: PoseEstimate) -> None:
        """Learn the odometry's errors from the pose of the scan."""
        if self.calibration is not None:
            is_good_match = found.inlier_ratio >= self.search_inlier_ratio
            self.calibration.learn(state.odometry_errors, found.pose, state.odometry, is_good_match, found.determined)

    def _is_determined(self, match: PoseMatch) -> bool:
        """Whether a match is non-degenerate, and better than calibrated odometry."""
        return match.degenerate_direction(calibrated(self.matcher).min_information) is None

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
            due = state.unlocalized_scans >= _MAX_UNMATCHED_SCANS
        last = track or SensorTrack.first(state.stamp_ns, found.pose)
        ends = beams.ends if len(state.sensors) > 1 else last.ends
        inserted_pose = found.pose if due else last.inserted_pose
        state.update_track(
            beams.scan.sensor,
            SensorTrack(state.stamp_ns, found.pose, found.inlier_ratio, inserted_pose, last.beam_order, ends),
        )
        if due:
            state.insert(beams, self.map_scans)
            self._remember(state, beams)

    def _remember(self, state: TrackerState, beams: Beams) -> None:
        """Let later scans be matched to the surfaces of this one."""
        newest = state.recent.scans[-1:]
        is_near = newest and is_within(newest[0].pose, state.pose, _SURFACES_M, _SURFACES_RAD)
        if len(state.sensors) == 1 and not is_near:
            state.recent = state.recent.insert(beams, state.pose, SURFACE_SCANS)


def _sudden_turns(twist: Pose, beams: Beams, fastest_rps: float) -> list[FloatArray]:
    """Twists (3,) with every turn up to the fastest one, as far apart as the turn within a scan can be matched."""
    times = beams.scan.beam_times_s
    assert times is not None
    step = _MATCHED_TURN_RAD / max(float(np.ptp(times)), 1e-3)
    most = int(fastest_rps / step)
    return [np.array([twist[0], twist[1], turn * step]) for turn in range(-most, most + 1)]


def _score(state: TrackerState, pose: Pose, beams: BeamEnds) -> float:
    """How many beams of a scan from `pose` agree with the local map."""
    return EVALUATE_ONLY.match_pose(state.maps, state.matched_map, pose, NO_INFORMATION, beams).score


@final
@checked
@parameters(frozen=True)
class OdometryTracker:
    """The tracker of GMapping: takes the odometry as it is, and so needs it with every scan."""

    def init(
        self, odometry: Odometry | None, stamp_ns: int, beams: Beams, mapper: OccupancyGridMapping
    ) -> TrackerState:
        """Start at the origin of the tracker's frame; ArgumentError where there is no odometry."""
        return TrackerState.start(mapper.empty(2), _require_odometry(odometry, stamp_ns), stamp_ns, beams.scan.sensor)

    def step(
        self,
        state: TrackerState,
        odometry: Odometry | None,
        stamp_ns: int,
        beams: Beams,
    ) -> TrackedScan:
        """Track one scan; updates `state`; ArgumentError where there is no odometry."""
        state.odometry = as_pose(_require_odometry(odometry, stamp_ns).pose)
        state.stamp_ns = stamp_ns
        state.pose = compose(state.matched_pose, between(state.matched_odometry, state.odometry))
        return TrackedScan(state.pose, state.pose, Control(state.pose), beams, beams)


def _require_odometry(odometry: Odometry | None, stamp_ns: int) -> Odometry:
    if odometry is None:
        expected = "a pose with every scan, as this tracker uses nothing else"
        raise ArgumentError("odometry", expected, f"none with the scan at {stamp_ns} ns")
    return odometry
