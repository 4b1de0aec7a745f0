"""The tracker: matches every scan to a sliding local map, and so turns odometry into a smooth, nearly exact one.

It never looks at anything older than its local maps, so it drifts slowly but never jumps when a loop closes. The
particles take its increments as their control (Haehnel et al. 2003). Where there is no odometry it goes by the robot's
velocity, and searches more widely.
"""

from __future__ import annotations

import math
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.se2 import between, compose
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import Pyramid
from gridslam.matching.gauss_newton import EVALUATE_ONLY, GaussNewton, degenerate_direction
from gridslam.slam.odometry_calibration import OdometryCalibration
from gridslam.slam.tracker_deskew import Deskew
from gridslam.slam.tracker_search import OdometrySearch
from gridslam.slam.tracker_state import Found, Prediction, Seen, Tracked, TrackerState, is_within, pose_of
from gridslam.slam.tracker_velocity import ConstantVelocity
from gridslam.types import BeamEnds, Beams, FloatArray, Match, Odometry

__all__ = ["Tracked", "Tracker", "TrackerState"]

_NO_PRIOR = np.full((1, 3, 3), 1e-9) * np.eye(3)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class Tracker:
    """Matches every scan to the older of two local maps that take turns.

    Parameters
    ----------
    still_m, still_rad : float
        A scan after less odometry than both takes the odometry, unless fewer of its beams agree than before: there is
        nothing to learn from it. Without odometry the robot stands while its matches stay within both.
    insert_m, insert_rad : float
        A scan is inserted after this much motion.
    map_scans : int
        A second local map is begun when the first holds so many scans of each laser, and replaces it when it does
        itself.
    beam_sigma_m : float, m
        Standard deviation of a beam's distance to the map against which the odometry's information is weighed. Far
        below a lidar's noise: beams are many, and odometry slips in ways that no variance tells. With seven times as
        much the Intel log is lost by 0.2 m and more.
    jump_m, jump_rad : float
        Odometry that moves farther between two scans than this and the speeds in `velocity` allow has jumped: it was
        reset, or a message was lost. Its increment is not used, as if there had been no odometry.
    poor_share : float
        A match with which a smaller share of the beams agrees is not believed: the scan sees mostly what is new, or a
        turn too fast for the scans' rate has led the descent astray. It takes the prediction.
    slip_m : float, m
        A match that moves the position farther than this from the odometry, and than four of the odometry's standard
        deviations, must convince: the wheels slipped, or a reading came late. Else something misled it (a person
        walking along, the dotted far end of a bare corridor, a scan smeared by a fast turn): the position keeps the
        odometry, and only the heading is taken.
    slip_gain : float
        Share of the beams that must agree more after such a match than before it.
    matcher : GaussNewton
        How a scan is matched.
    steady_matcher : GaussNewton
        The same where the odometry's errors are known: what the scan tells but weakly, the odometry tells better. Where
        directions are better determined than that, the odometry's errors are learned.
    velocity : ConstantVelocity
        What is predicted where there is no odometry.
    join_m, join_rad : float
        A scan is matched together with what the other lasers saw last, from no farther away than both by the odometry;
        where there is none, from a twentieth of that.
    search_share : float
        Where a smaller share of the beams agrees with a match, a better one is searched for from the velocity's
        prediction and all around: on real logs more agree in the right place, and fewer in others.
    patience : int
        Without odometry, a scan is inserted although it fits nowhere after so many others that did not.
    search : OdometrySearch
        How a scan is searched for around the odometry where scans are far apart.
    deskew : Deskew or None
        How scans with beam times are deskewed; None: they are taken as they are.
    calibration : OdometryCalibration or None
        How the odometry's errors are learned; None: it is taken as it is.
    """

    still_m: float = Field(default=0.005, ge=0)
    still_rad: float = Field(default=0.005, ge=0)
    insert_m: float = Field(default=0.2, gt=0)
    insert_rad: float = Field(default=0.1, gt=0)
    map_scans: int = Field(default=20, ge=1)
    beam_sigma_m: float = Field(default=0.0016, gt=0)
    jump_m: float = Field(default=1.0, gt=0)
    jump_rad: float = Field(default=1.0, gt=0)
    poor_share: float = Field(default=0.5, ge=0, le=1)
    slip_m: float = Field(default=0.08, gt=0)
    slip_gain: float = Field(default=0.1, ge=0, le=1)
    matcher: GaussNewton = GaussNewton()
    steady_matcher: GaussNewton = GaussNewton(min_information=0.05)
    velocity: ConstantVelocity = ConstantVelocity()
    join_m: float = Field(default=0.3, ge=0)
    join_rad: float = Field(default=0.3, ge=0)
    search_share: float = Field(default=0.7, ge=0, le=1)
    patience: int = Field(default=3, ge=1)
    search: OdometrySearch = OdometrySearch()
    deskew: Deskew | None = Deskew()
    calibration: OdometryCalibration | None = OdometryCalibration()

    def init(
        self, odometry: Odometry | None, stamp_ns: int, beams: Beams, mapper: OccupancyGridMapping
    ) -> TrackerState:
        """Start at the origin of the tracker's frame with the first scan."""
        state = TrackerState.start(mapper.empty(2), odometry, stamp_ns, beams.scan.sensor)
        state.maps.update(state.row, state.pose[None], beams)
        return state

    def step(self, state: TrackerState, odometry: Odometry | None, stamp_ns: int, beams: Beams) -> Tracked:
        """Track one scan; updates `state`."""
        at, seconds = pose_of(odometry), self.velocity.seconds(state, stamp_ns)
        predicted, spread = self._predicted(state, at, stamp_ns, seconds), state.spread
        if self.deskew is None or beams.scan.beam_times_s is None:
            found = self._found(state, predicted, beams)
        else:
            found, beams = self.deskew(
                state, predicted, lambda pose: self.velocity.twist(state, pose, seconds), beams,
                lambda sharp: self._found(state, predicted, sharp),
            )  # fmt: skip
        joint = self._joined(state, found.pose, found.predicted, beams)
        self._advance(state, found)
        state.overruled += odometry is not None and not found.predicted.by_odometry
        if found.matched or not found.predicted.by_odometry:
            state.matched_pose, state.matched_odometry = found.pose, at
        state.stamp_ns, state.odometry = stamp_ns, at
        if found.matched:
            self._learn(state, found)
            self._insert(state, found, beams)
        if not found.predicted.by_odometry:
            return Tracked(found.pose, found.predicted.pose, beams, joint, spread)
        control, widening = self.search.control(state, found)
        return Tracked(found.pose, control, beams, joint, widening)

    def _predicted(self, state: TrackerState, at: FloatArray, stamp_ns: int, seconds: float) -> Prediction:
        told = between(state.matched_odometry, at)
        if math.isnan(told[0]) or not state.learned.trusted or self._jumped(state, at, stamp_ns):
            return self._by_velocity(state, seconds)
        increment = state.learned.corrected(told)
        moved, turned = _motion(increment)
        sigmas = self._odometry_sigma(moved, turned, state.maps.resolution_m)
        pose = compose(state.matched_pose, increment)
        return Prediction(pose, True, seconds, moved, turned, *sigmas, self.beam_sigma_m)

    def _by_velocity(self, state: TrackerState, seconds: float) -> Prediction:
        velocity = self.velocity
        pose, sigmas = velocity.predicted(state, seconds), velocity.sigmas(seconds)
        turned = abs(float(state.twist[2])) * seconds
        return Prediction(pose, False, seconds, 0.0, turned, *sigmas, velocity.beam_sigma_m)

    def _jumped(self, state: TrackerState, at: FloatArray, stamp_ns: int) -> bool:
        dx, dy, turn = (at - state.odometry).tolist()
        seconds = abs(stamp_ns - state.stamp_ns) * 1e-9
        far = math.hypot(dx, dy) > self.jump_m + self.velocity.speed_mps * seconds
        return far or abs(math.remainder(turn, math.tau)) > self.jump_rad + self.velocity.turn_rps * seconds

    def _found(self, state: TrackerState, predicted: Prediction, beams: Beams) -> Found:
        """Where a scan was taken."""
        seen = state.sensors.get(beams.scan.sensor)
        if seen is None:  # the other lasers may look elsewhere
            return Found(predicted.pose, predicted, matched=len(beams) > 0, poor=False)
        joint = self._joined(state, predicted.pose, predicted, beams)
        if not len(beams) or len(joint) < self.matcher.min_beams:
            return Found(predicted.pose, predicted, matched=False, poor=not predicted.by_odometry)
        if not predicted.by_odometry:
            return self._searched(state, predicted, joint)
        if self._still(state, seen, predicted, joint):
            return Found(predicted.pose, predicted, matched=False, poor=False)
        found = self._matched(state, predicted, joint)
        if found.share < self.search_share:  # it may be the odometry that is wrong: a reading came late
            other = self._found_elsewhere(state, predicted, joint)
            convinces = other.share >= self.search_share and other.share - found.share > self.slip_gain
            found = other if convinces else found
        return found

    def _found_elsewhere(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> Found:
        """Search around the velocity's prediction; around the odometry's where velocities tell nothing."""
        if self.search.is_far(state, predicted):
            return self.search(state, predicted, beams)
        return self._searched(state, self._by_velocity(state, predicted.seconds), beams)

    def _joined(self, state: TrackerState, pose: FloatArray, predicted: Prediction, beams: Beams) -> BeamEnds:
        """The scan, taken at about `pose`, with those of the other lasers."""
        trusted = 1.0 if predicted.by_odometry else 0.05
        return state.joined(beams, pose, trusted * self.join_m, trusted * self.join_rad)

    def _still(self, state: TrackerState, seen: Seen, predicted: Prediction, beams: BeamEnds) -> bool:
        """Whether the robot has not moved, by the odometry, and the scan does not say otherwise."""
        if not is_within(seen.matched_pose, predicted.pose, self.still_m, self.still_rad):
            return False
        share = EVALUATE_ONLY(state.maps, state.row, predicted.pose[None], _NO_PRIOR, beams).score[0] / len(beams)
        return bool(share > seen.share - self.slip_gain)

    def _matched(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> Found:
        """Match from a prediction by odometry; where a match is implausible, only its heading is taken."""
        known = self.calibration is not None and self.calibration.is_known(state.learned)
        matcher = self.steady_matcher if known else self.matcher
        match = matcher(state.maps, state.row, predicted.pose[None], predicted.prior, beams)
        best, score = match.poses[0], float(match.score[0])
        pose = best
        if score < self.poor_share * len(beams):
            return Found(predicted.pose, predicted, matched=True, poor=True)
        away = math.hypot(pose[0] - predicted.pose[0], pose[1] - predicted.pose[1])
        if away > max(self.slip_m, 4 * predicted.sigma_m):
            stayed = np.array([predicted.pose[0], predicted.pose[1], pose[2]])
            before = EVALUATE_ONLY(state.maps, state.row, stayed[None], _NO_PRIOR, beams).score[0]
            pose = pose if score - float(before) > self.slip_gain * len(beams) else stayed
        determined = pose is best and self._determined(match)
        return Found(pose, predicted, matched=True, poor=False, share=score / len(beams), determined=determined)

    def _searched(self, state: TrackerState, predicted: Prediction, beams: BeamEnds) -> Found:
        """Match from a prediction by the velocity; where few beams agree, search all around it."""
        maps, row, count = state.maps, state.row, len(beams)
        match = self.matcher(maps, row, predicted.pose[None], predicted.prior, beams)
        if match.score[0] < self.search_share * count:
            search = self.velocity.search(state, predicted.seconds)
            place = search.search(Pyramid.of(maps, state.active), predicted.pose, None, beams.ends)
            if place is not None:
                other = self.matcher(maps, row, place.pose[None], _NO_PRIOR, beams)
                convinces = other.score[0] - match.score[0] > self.slip_gain * count
                match = other if convinces and other.score[0] >= self.search_share * count else match
        if match.score[0] < self.poor_share * count:
            return Found(predicted.pose, predicted, matched=True, poor=True)
        pose, score = match.poses[0], float(match.score[0])
        stands = is_within(state.pose, pose, self.still_m, self.still_rad)
        determined = self._determined(match)
        return Found(state.pose if stands else pose, predicted, True, False, score / count, determined)

    def _advance(self, state: TrackerState, found: Found) -> None:
        """Move on; where nothing is known of the motion, the robot is thought to come to rest."""
        predicted = found.predicted
        if found.poor or self.search.was_blind(state, predicted):
            state.doubt_m2 += predicted.sigma_m**2
            state.doubt_rad2 += predicted.sigma_rad**2
        moved, turned = _motion(between(state.pose, found.pose))
        if moved + turned > self.still_m + self.still_rad:
            state.stride += 0.05 * (min(moved + turned, self.search.gap_way) - state.stride)
        blind = found.poor and not predicted.by_odometry
        state.twist = 0.5 * state.twist if blind else self.velocity.twist(state, found.pose, predicted.seconds)
        if found.share and not predicted.by_odometry:
            state.spread = self.velocity.spread(state.spread, between(predicted.pose, found.pose))
        state.blind_scans = state.blind_scans + 1 if blind else 0
        state.pose = found.pose

    def _learn(self, state: TrackerState, found: Found) -> None:
        """Learn what the odometry's errors are, from where the scan was taken."""
        if self.calibration is not None:
            believed = found.share >= self.search_share
            self.calibration.learn(state.learned, found.pose, state.odometry, believed, found.determined)

    def _determined(self, match: Match) -> bool:
        """Whether a match tells the position in all directions, better than odometry whose errors are known."""
        least = self.steady_matcher.min_information
        return degenerate_direction(match.information[0], float(match.score[0]), least) is None

    def _odometry_sigma(self, moved: float, turned: float, cell: float) -> tuple[float, float]:
        """Standard deviations (m, rad) of an increment of odometry, from a tenth of a cell on."""
        return 0.1 * cell + 0.15 * moved + 0.5 * cell * turned, 0.003 + 0.05 * turned + 0.04 * moved

    def _insert(self, state: TrackerState, found: Found, beams: Beams) -> None:
        """Insert the scan if its laser has moved since its last one, and if one knows where it was taken."""
        seen = state.sensors.get(beams.scan.sensor)
        state.even = state.even or (seen is not None and self.velocity.doubts_stamps(seen, state.stamp_ns, found.pose))
        due = seen is None or not is_within(seen.inserted_pose, found.pose, self.insert_m, self.insert_rad)
        if found.poor and found.predicted.by_odometry:  # smeared by a turn, or seen at another time than the stamp's
            due = due and (self.search.is_far(state, found.predicted) or found.predicted.turned_rad <= self.insert_rad)
        elif found.poor:  # what is seen is new, but one scan does not decide that
            due = state.blind_scans >= self.patience
        last = seen or Seen.first(state.stamp_ns, found.pose)
        ends = beams.ends if len(state.sensors) > 1 else last.ends
        last = last._replace(stamp_ns=state.stamp_ns, matched_pose=found.pose, share=found.share, ends=ends)
        state.note(beams.scan.sensor, last._replace(inserted_pose=found.pose) if due else last)
        if due:
            state.insert(beams, self.map_scans)


def _motion(increment: FloatArray) -> tuple[float, float]:
    """Metres and radians of an increment (3,)."""
    x, y, turn = increment.tolist()
    return math.hypot(x, y), abs(turn)
