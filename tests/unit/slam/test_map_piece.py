"""Pieces of a map: how two are joined, and how a filter goes on in a map that an earlier drive has left."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import Configuration, build, override
from gridslam.geometry.se2 import between, compose
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.full_slam.full_slam import full_slam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure import loop_closure as loop_closure_module
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.state import FoundPiece, RejectionReason
from gridslam.types import StoredScan
from support.loops import loop_drive

CONFIG = override(Configuration(), "particles=4")
ELSEWHERE = np.array([30.0, -20.0, 2.0])


def archive(count, seed):
    rng = np.random.default_rng(seed)
    kept = ScanArchive()
    for k in range(count):
        scan = StoredScan(rng.uniform(-9, 9, (7, 2)), np.zeros(2))
        kept.append(scan, np.array([0.1 * k, 0.0, 0.0]), is_key=k % 3 == 0)
    return kept


def chain(count, seed):
    rng = np.random.default_rng(seed)
    graph = KeyGraph()
    tracked = pose = rng.normal(size=3)
    for _ in range(count):
        moved = np.array([0.4, 0.0, rng.normal(0, 0.1)])
        tracked, pose = compose(tracked, moved), compose(pose, moved)
        graph.extend(tracked, pose, (1e-4, 1e-6))
    return graph


def recognized(from_, to, measurement):
    return Constraint(from_, to, measurement, 1e4 * np.eye(3), ConstraintSource.RECOGNIZED, True)


@pytest.fixture
def pieces():
    return MapPiece(archive(30, 0), chain(10, 0)), MapPiece(archive(45, 1), chain(15, 1))


@pytest.fixture
def match(pieces):
    poses = compose(ELSEWHERE, pieces[1].poses)
    return PieceMatch(poses, [recognized(4, 6, between(pieces[0].poses[4], poses[6]))])


def test_each_drive_stays_as_it_was_tracked_and_lies_where_it_was_found(pieces, match):
    graph = pieces[0].append(pieces[1], match).graph
    assert len(graph) == 25
    np.testing.assert_array_equal(graph.tracked[10:], pieces[1].graph.tracked)  # the later robot drives on
    tracked = np.array(graph.tracked[:10])
    before = np.array(pieces[0].graph.tracked)
    np.testing.assert_allclose(between(tracked[:-1], tracked[1:]), between(before[:-1], before[1:]), atol=1e-9)
    np.testing.assert_array_equal(graph.poses[:10], pieces[0].poses)
    np.testing.assert_array_equal(graph.poses[10:], match.poses)
    across = between(graph.tracked[9], graph.tracked[10])
    np.testing.assert_allclose(across, between(graph.poses[9], graph.poses[10]), atol=1e-9)


@pytest.fixture(scope="module")
def halves():
    """Two drives through one building, the second from an origin of its own, and the true poses of both."""
    log = loop_drive()
    cut = len(log.measurements) // 2
    later = [
        (replace(odometry, pose=compose(ELSEWHERE, odometry.pose)), scan)
        for odometry, scan in log.measurements[cut - 40 :]
    ]
    truth = np.array(log.truth.poses)
    return (log.measurements[:cut], truth[:cut]), (later, truth[cut - 40 :])


def drive(measurements, state=None, slam=None):
    recorder = TrajectoryRecorder()
    state = run(
        measurements,
        slam or build(CONFIG),
        rng=np.random.default_rng(0),
        observers=[recorder],
        state=state,
    )
    return state, recorder


def key_scans(recorder):
    return np.flatnonzero(np.diff(recorder.keys, prepend=-1))


def test_a_drive_goes_on_in_the_map_of_an_earlier_one(halves):
    """Once it was found there all that is known has one frame: the key scans of both, and every scan of both."""
    (first, first_truth), (second, second_truth) = halves
    before, earlier = drive(first)
    piece = MapPiece(before.closure_state.scans, before.closure_state.graph)
    slam = build(CONFIG)
    state, recorder = drive(second[:40])  # scans that the first drive has, too
    poses = earlier.best_trajectory(before).poses[-40:][key_scans(recorder)]
    near = [int(np.hypot(*(piece.poses - pose)[:, :2].T).argmin()) for pose in poses]
    known = np.diag([100.0, 100.0, 400.0])  # both poses are the filter's: good to 10 cm and 0.05 rad
    constraints = [
        recognized(n, k, between(piece.poses[n], poses[k]))._replace(information=known)
        for k, n in enumerate(near)
        if k % 3 == 0
    ]
    found = FoundPiece(0, piece, piece.build_map(slam.mapper), PieceMatch(poses, constraints))
    slam.loop_closure.join(state, state.closure_state, found)
    assert state.closure_state.joined == 0
    state = run(second[40:], slam, rng=np.random.default_rng(1), observers=[recorder], state=state)

    drives = [earlier.tracked_scans(), recorder.tracked_scans(len(piece))]
    parts = CONFIG.mapper, CONFIG.loop_closure
    answer = full_slam(state, drives, *parts)
    assert len(answer.poses) == len(first) + len(second)
    twice = len(first) - 40  # the scans that both drives have
    apart = answer.poses[twice : len(first)] - answer.poses[len(first) : len(first) + 40]
    assert np.hypot(*apart[:, :2].T).max() < 0.05
    alone = full_slam(before, [earlier.tracked_scans()], *parts).poses
    truth = between(first_truth[0], np.concatenate([first_truth, second_truth]))
    off, off_alone = (np.hypot(*(poses - truth[: len(poses)])[:, :2].T) for poses in (answer.poses, alone))
    assert off.max() < off_alone.max() + 0.05  # the later drive adds no error of its own
    sigmas = np.sqrt(np.trace(answer.covariances[:, :2, :2], axis1=1, axis2=2))
    assert sigmas.max() < 1.0


class LocatedAfterTenKeyScans:
    """Finds a drive in a piece at once: it begins at `pose` there."""

    def __init__(self, piece, pose, mapper):
        self.piece, self.pose, self.mapper = piece, pose, mapper

    def locate(self, closure_state):
        poses = np.array(closure_state.graph.poses)
        if len(poses) < 10:
            return None
        match = PieceMatch(compose(self.pose, between(poses[0], poses)), [])
        return FoundPiece(0, self.piece, self.piece.build_map(self.mapper), match)


@pytest.mark.parametrize("owner", ["insert_key_scans", "MapPiece.append", "replace_trajectory"])
def test_where_a_drive_cannot_be_joined_it_goes_on_and_is_joined_later(halves, monkeypatch, owner):
    """Nothing of the piece is in the state that is revived, and nothing of the drive is lost."""
    (first, _), (second, _) = halves
    before, recorder = drive(first)
    piece = MapPiece(before.closure_state.scans, before.closure_state.graph)
    begin = recorder.best_trajectory(before).poses[len(first) - 40]
    slam = build(CONFIG)
    state, recorder = drive(second[:1])
    state.closure_state.earlier = LocatedAfterTenKeyScans(piece, begin, slam.mapper)
    state.closure_state.rejected[RejectionReason.INCONSISTENT] = 1000
    holder, name = {
        "insert_key_scans": (loop_closure_module, "insert_key_scans"),
        "MapPiece.append": (MapPiece, "append"),
        "replace_trajectory": (GridFastSlamState, "replace_trajectory"),
    }[owner]
    real = getattr(holder, name)
    tries = []

    def fail_thrice(*arguments):
        result = real(*arguments)
        tries.append(len(tries))
        if len(tries) <= 3:
            raise MemoryError
        return result

    failures = []
    with monkeypatch.context() as patched:
        patched.setattr(holder, name, fail_thrice)
        options = {"observers": [recorder], "state": state, "on_failure": failures.append}
        state = run(second[1:120], slam, rng=np.random.default_rng(1), **options)
    assert [type(failed.error) for failed in failures] == [MemoryError] * 3
    closure_state = state.closure_state
    assert closure_state.joined == 0
    assert closure_state.joined_after == 10
    assert closure_state.rejected[RejectionReason.INCONSISTENT] >= 1000
    keys = len(piece) + recorder.keys[-1] + 1
    assert len(closure_state.graph) == len(closure_state.scans.keys) == len(state.best_trajectory()) == keys
    assert len(closure_state.scans) == len(first) + 120 - 3
