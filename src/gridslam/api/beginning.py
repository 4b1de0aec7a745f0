"""The start of a run: an empty map, or the maps of earlier drives."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import NamedTuple, final

import numpy as np

from gridslam.config import Configuration
from gridslam.geometry.single_pose import ORIGIN, Pose, as_pose, between, compose, is_known, motion_of
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.drives import DrivenLog, SavedPiece, choose_name
from gridslam.io.sessions.session_file import SavedRun
from gridslam.matching.gauss_newton import NO_PRIOR
from gridslam.pipeline import FailureRecorder
from gridslam.slam.full_slam.earlier_pieces import EarlierPieces
from gridslam.slam.full_slam.full_slam import full_slam
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.tracking.state import pose_of
from gridslam.tracking.tracker import Tracker
from gridslam.types import FloatArray, LaserScan, StepReport, describe_duration

_MAX_GAP_S = 600.0
"""Longest time between two logs of one drive; after a longer one the robot begins a new drive."""
_MAX_SPEED_M_S = 2.0
_JITTER_M = 0.5
_JITTER_RAD = 0.5
_MAX_GAIN_M = 0.3
"""A scan fits where it was expected if it is matched no farther from there."""
_MIN_INLIER_RATIO = 0.6


class Place(Enum):
    """Where a log begins, as seen from where the last one has ended."""

    AUTO = "auto"
    SAME = "same place"
    ELSEWHERE = "elsewhere"


@final
class PlaceDecision(NamedTuple):
    """Whether a log continues at the end of the last one, and the reason in one line."""

    is_same: bool
    reason: str


@final
@dataclass(frozen=True, slots=True, eq=False)
class Beginning:
    """The start of a run.

    Attributes
    ----------
    run : SavedRun
        The filter and its observers so far; new ones for a new drive.
    pieces : tuple of SavedPiece
        Other pieces of the map of earlier drives.
    locator : EarlierPieces or None
        Looks for the robot in the pieces, until it is found.
    failures : FailureRecorder
        The scans of the log so far at which the filter has failed.
    """

    run: SavedRun
    pieces: tuple[SavedPiece, ...] = ()
    locator: EarlierPieces | None = None
    failures: FailureRecorder = field(default_factory=FailureRecorder)

    def attach(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Make a filter that has just started search for the robot in the pieces."""
        self.attach_to(state)

    def attach_to(self, state: GridFastSlamState | None) -> GridFastSlamState | None:
        """Let a filter look for the robot in the pieces, unless it was found; gives the state."""
        if self.locator is not None and state is not None and state.closure_state is not None:
            state.closure_state.earlier = self.locator if state.closure_state.joined < 0 else None
        return state

    def finish(self, state: GridFastSlamState, slam: GridFastSlam) -> None:
        """Look for a robot that was not found while it drove by all of its drive."""
        closure_state = state.closure_state
        if closure_state is None or closure_state.earlier is None or slam.loop_closure is None or self.locator is None:
            return
        found = self.locator.locate_whole(closure_state)
        if found is not None:
            slam.loop_closure.join(state, closure_state, found)

    def go_on(self, state: GridFastSlamState, *logs: DrivenLog) -> Beginning:
        """Return the state of the run after a scan, to be saved or continued; `logs` are those that have ended since.

        Whatever saves a run, or computes its result, saves this: the drives of the piece in which the robot was found
        come before the run's own, and that piece is not among the others any more.
        """
        run = replace(self.run, state=state, logs=(*self.run.logs, *logs))
        joined = self.find_joined(state)
        if joined is None:
            return replace(self, run=run)
        apart = tuple(piece for piece in self.pieces if piece is not joined)
        return replace(self, run=replace(run, earlier=joined.drives), pieces=apart, locator=None)

    def find_joined(self, state: GridFastSlamState) -> SavedPiece | None:
        """Find the one of the pieces that the run was joined with; None if none was, or before it began with them."""
        found_in = None if state.closure_state is None else state.closure_state.found_in
        return next((piece for piece in self.pieces if piece.piece is found_in), None)


def locate_in(
    pieces: Sequence[SavedPiece],
    configuration: Configuration,
    run: SavedRun,
    pose: FloatArray | None = None,
) -> EarlierPieces | None:
    """Return a locator of the robot of a run in pieces: anywhere, or near a pose (3,) at which it begins in the first.

    None without loop closure, without pieces, and where the run has a state in which the robot was found.
    """
    closure, state = configuration.loop_closure, run.state
    is_found = state is not None and state.closure_state is not None and state.closure_state.joined >= 0
    if closure is None or not pieces or is_found:
        return None
    return EarlierPieces([piece.piece for piece in pieces], configuration.mapper, closure.places, begin=pose)


def begin_new_piece(
    ended: Beginning, configuration: Configuration, seed: int, on_progress: Callable[[], None] = lambda: None
) -> Beginning:
    """Return the start of a carried robot's next drive: the robot is searched for in its map so far.

    The same as where another log is added to a session; `ended` is what `Beginning.go_on` gives after the last scan.
    """
    run = ended.run
    if run.state is None:
        return ended
    drives = [drive.scans for drive in run.drives]
    full = full_slam(run.state, drives, configuration.mapper, configuration.loop_closure, on_progress)
    if full.piece is None:
        return ended  # without loop closure no drive can be relocalized
    pieces = (SavedPiece(full.piece, run.drives), *ended.pieces)
    names = [drive.name for piece in pieces for drive in piece.drives]
    rng = np.random.default_rng(seed + len(names))
    begun = SavedRun(rng, name=choose_name(run.name, names), statistics=run.statistics)
    return replace(ended, run=begun, pieces=pieces, locator=locate_in(pieces, configuration, begun))


def decide_place(run: SavedRun, slam: GridFastSlam, first: Measurement) -> PlaceDecision:
    """Decide whether a log that begins with this measurement continues at the end of a run.

    It does if its stamps and its odometry go on, and its first scan fits the newest local map where the odometry
    expects it. Without odometry stamps and scan decide.
    """
    state = run.state
    if state is None:
        return PlaceDecision(False, "there is no earlier drive")
    odometry, scan = first
    gap_s = 1e-9 * (scan.stamp_ns - state.tracker.stamp_ns)
    moved = None if odometry is None else between(state.tracker.odometry, as_pose(odometry.pose))
    if moved is not None and not is_known(moved):
        moved = None
    side = "after" if gap_s >= 0 else "before"
    reasons = [f"the first scan is {describe_duration(gap_s)} {side} the last one"]
    is_on_time = 0 <= gap_s <= _MAX_GAP_S
    goes_on = is_on_time
    if moved is not None:
        metres, radians = motion_of(moved)
        near = metres <= _JITTER_M + _MAX_SPEED_M_S * min(max(gap_s, 0.0), 1.0) and radians <= _JITTER_RAD
        is_reset = odometry is not None and not odometry.pose.any() and any(state.tracker.odometry)
        goes_on = goes_on and near and not is_reset
        reasons.append("the odometry was reset" if is_reset else f"the odometry is {metres:.2f} m from there")
    ratio, away_m = _match_first(state, slam, scan, ORIGIN if moved is None or not goes_on else moved)
    fits = ratio >= _MIN_INLIER_RATIO and away_m <= _MAX_GAIN_M
    reasons.append(f"{ratio:.0%} of its beams fit the map {'there' if fits else 'there, too few or too far away'}")
    return PlaceDecision(goes_on and fits, ", ".join(reasons))


def _match_first(state: GridFastSlamState, slam: GridFastSlam, scan: LaserScan, moved: Pose) -> tuple[float, float]:
    """Return inlier ratio of a scan in the newest local map, and the distance (m) from where it was expected."""
    if not isinstance(slam.tracker, Tracker):
        return 1.0, 0.0  # that tracker trusts its odometry
    tracker = state.tracker
    expected = compose(tracker.pose, moved)
    beams = scan.beams(slam.range_min_m, slam.range_max_m, slam.thinning)
    if len(beams) < slam.tracker.matcher.min_beams:
        return 0.0, 0.0
    match = slam.tracker.matcher(tracker.maps, tracker.row, np.array([expected]), NO_PRIOR[None], beams)
    away = between(expected, as_pose(match.poses[0]))
    return float(match.score[0]) / len(beams), math.hypot(away[0], away[1])


def restart_at_same_place(state: GridFastSlamState, first: Measurement) -> None:
    """Restart a filter at its current place although odometry or clock were reset, as by a restart there."""
    odometry, scan = first
    tracker = state.tracker
    tracker.stamp_ns = scan.stamp_ns
    tracker.odometry = tracker.matched_odometry = pose_of(odometry)
    tracker.matched_pose = tracker.pose
    tracker.twist = ORIGIN
