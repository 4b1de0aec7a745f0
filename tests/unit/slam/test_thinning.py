"""A piece forgets what newer drives have seen, and nothing else."""

import numpy as np
import pytest

from gridslam.config import Configuration
from gridslam.geometry.se2 import between, compose
from gridslam.slam.full_slam.full_trajectory import TrackedScans, full_trajectories
from gridslam.slam.full_slam.thinning import thin_piece
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.types import StoredScan

MAPPER = Configuration().mapper
KEYS = 20
"""Of a drive: two submaps."""
ANGLES = np.linspace(-np.pi, np.pi, 90, endpoint=False)
ROOM = StoredScan(4.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), np.zeros(2))


def drive(x, seed):
    """A drive of 20 key scans, each followed by two other scans, along 2 m of a round room about (x, 0)."""
    rng = np.random.default_rng(seed)
    archive, graph, keys, moved = ScanArchive(), KeyGraph(), [], []
    for key in range(KEYS):
        pose = np.array([x + 0.1 * key + rng.normal(0, 0.01), 0.0, rng.normal(0, 0.01)])
        tracked = compose(np.array([50.0, 3.0, 1.0]), pose)
        graph.extend(tracked, pose, (1e-4, 1e-6))
        before = graph.tracked[-2] if key else tracked
        for between_keys in range(3):
            step = np.array([0.03 * between_keys, 0.0, 0.0])
            archive.append(ROOM, compose(tracked, step), is_key=not between_keys)
            keys.append(key)
            moved.append(compose(between(before, tracked), step) if not between_keys else step)
    return MapPiece(archive, graph), TrackedScans(np.array(keys), np.array(moved))


def join(places, closures=None):
    """A piece of several drives, each about a place, with a closure from each to the one before."""
    piece, first = drive(places[0], 0)
    drives = [first]
    for number, x in enumerate(places[1:], 1):
        later, scans = drive(x, number)
        from_, to = (closures or {}).get(number, (len(piece) - 1, 0))
        information, source = 1e4 * np.eye(3), ConstraintSource.RECOGNIZED
        pose = between(piece.poses[from_], later.poses[to])
        match = PieceMatch(later.poses, [Constraint(from_, to, pose, information, source, True)])
        drives.append(scans._replace(keys=len(piece) + scans.keys))
        piece = piece.append(later, match)
    return piece, drives


def drives_left(thinned):
    return [k for k, scans in enumerate(thinned.drives) if len(scans.keys)]


def test_the_newest_two_drives_through_a_place_are_kept():
    thinned = thin_piece(*join([0.0] * 5), MAPPER)
    assert drives_left(thinned) == [3, 4]
    assert len(thinned.piece) == 2 * KEYS


def test_the_size_stays_that_of_two_drives_however_often_the_place_is_visited():
    piece, drives = join([0.0, 0.0])
    for day in range(6):
        later, scans = drive(0.0, 10 + day)
        last = len(piece) - 1
        constraint = Constraint(last, 0, between(piece.poses[last], later.poses[0]), 1e4 * np.eye(3), *_RECOGNIZED)
        drives = [*drives, scans._replace(keys=len(piece) + scans.keys)]
        thinned = thin_piece(piece.append(later, PieceMatch(later.poses, [constraint])), drives, MAPPER)
        piece = thinned.piece
        drives = [scans for scans in thinned.drives if len(scans.keys)]
        assert len(piece) == 2 * KEYS
        assert len(piece.scans) == 6 * KEYS
        assert len(set(piece.graph.label_rigid_components().tolist())) == 1


_RECOGNIZED = ConstraintSource.RECOGNIZED, True


def test_scans_between_key_scans_keep_their_beams_in_the_newest_drive_alone():
    piece, drives = join([0.0, 0.0])
    thinned = thin_piece(piece, drives, MAPPER)
    assert len(thinned.piece) == len(piece)
    beams = [len(thinned.piece.scans[scan].ends) for scan in range(len(thinned.scans))]
    assert beams == [90, 0, 0] * KEYS + [90] * 3 * KEYS
    again = thin_piece(thinned.piece, thinned.drives, MAPPER)
    assert again.piece.scans.nbytes == thinned.piece.scans.nbytes
    poses = full_trajectories(piece.poses, drives)
    np.testing.assert_allclose(full_trajectories(thinned.piece.poses, thinned.drives), poses, atol=1e-9)


def test_what_is_left_does_not_move_and_its_scans_are_what_they_were():
    piece, drives = join([0.0, 100.0, 0.0, 0.0, 0.0])
    thinned = thin_piece(piece, drives, MAPPER)
    assert 0 < len(thinned.key_scans) < len(piece)
    assert thinned.piece.poses.tobytes() == piece.poses[thinned.key_scans].tobytes()
    for new, old in enumerate(thinned.scans.tolist()):
        if old in piece.scans.keys or old >= 12 * KEYS:
            np.testing.assert_array_equal(thinned.piece.scans[new].ends, piece.scans[old].ends)
    assert [int(thinned.scans[key]) for key in thinned.piece.scans.keys] == [
        piece.scans.keys[key] for key in thinned.key_scans.tolist()
    ]
    left = [drive for drive in thinned.drives if len(drive.keys)]
    found = full_trajectories(thinned.piece.poses, left)
    whole = full_trajectories(piece.poses, drives)[thinned.scans]
    np.testing.assert_allclose(found, whole, atol=1e-9)


def test_a_drive_of_which_a_place_is_seen_nowhere_else_is_kept_whole():
    """The second drive leads on from the room that all others see to one that it alone has seen."""
    piece, drives = join([0.0, 0.0, 0.0, 0.0])
    far = compose(np.array([100.0, 0.0, 0.0]), piece.poses[KEYS + 10 : 2 * KEYS])
    piece.graph.correct(np.concatenate([piece.poses[: KEYS + 10], far, piece.poses[2 * KEYS :]]))
    assert drives_left(thin_piece(piece, drives, MAPPER)) == [1, 2, 3]


def test_key_scans_and_constraints_of_the_drives_that_are_left_are_what_they_were():
    piece, drives = join([0.0] * 4, {1: (5, 3), 2: (KEYS + 5, 3), 3: (2 * KEYS + 5, 3)})
    piece.graph.frozen = 3 * KEYS
    graph = thin_piece(piece, drives, MAPPER).piece.graph
    for name in ("tracked", "odometry", "poses"):
        np.testing.assert_array_equal(getattr(graph, name), getattr(piece.graph, name)[2 * KEYS :])
    for name in ("variances", "covariances", "drift_covariances"):
        np.testing.assert_array_equal(getattr(graph, name)[1:], getattr(piece.graph, name)[2 * KEYS + 1 :])
    assert not graph.begins_drive(0)
    assert graph.begins_drive(KEYS)
    assert graph.frozen == KEYS
    (left,) = graph.constraints
    assert left.pair == (5, KEYS + 3)
    np.testing.assert_array_equal(left.measurement, piece.graph.constraints[-1].measurement)


@pytest.mark.parametrize("is_bridge", [True, False])
def test_what_holds_others_together_is_kept(is_bridge):
    """Drive 1, long superseded, is all that joins a far place with the rest; or each newer one does, too."""
    closures = {1: (5, 15)} | dict.fromkeys((2, 3, 4), (KEYS + 15 if is_bridge else 5, 3))
    piece, drives = join([100.0, 0.0, 0.0, 0.0, 0.0], closures)
    thinned = thin_piece(piece, drives, MAPPER)
    assert len(set(piece.graph.label_rigid_components().tolist())) == 1
    assert len(set(thinned.piece.graph.label_rigid_components().tolist())) == 1
    assert (1 in drives_left(thinned)) == is_bridge


SIGHTS = 30
"""Of a wall in one furnished_drive, far more than it takes to be certain."""
NEAR = StoredScan(np.stack([np.full(81, 3.0), np.linspace(-1, 1, 81)], axis=1), np.zeros(2))
FAR = StoredScan(np.stack([np.full(81, 5.0), np.linspace(-1.6, 1.6, 81)], axis=1), np.zeros(2))


def furnished_drive(*scans):
    archive, graph = ScanArchive(), KeyGraph()
    for scan in scans:
        archive.append(scan, np.zeros(3), is_key=True)
        graph.extend(np.zeros(3), np.zeros(3), (1e-4, 1e-6))
    return MapPiece(archive, graph)


def occupied(piece, ends):
    """Which of the cells of the middle ends are occupied, and which free, in a piece's map."""
    grid = piece.build_map(Configuration().mapper).occupancy(0)
    column, row = np.floor((ends - grid.origin) / grid.resolution_m).astype(int).T
    log_odds = grid.log_odds[row, column][20:61]
    return np.mean(log_odds > 2.0), np.mean(log_odds < -1.41)  # as map_server counts free


@pytest.fixture
def moved():
    """A wall that stood 3 m off for a whole furnished_drive, and 5 m off for a few sights of the next one."""

    def of(sights):
        later = furnished_drive(*[FAR] * sights)
        return furnished_drive(*[NEAR] * SIGHTS).append(later, PieceMatch(later.poses, []))

    return of


@pytest.mark.parametrize(("sights", "is_free"), [(3, False), (16, True)])
def test_what_has_gone_is_free_after_few_beams_of_the_next_drive(moved, sights, is_free):
    stands, free = occupied(moved(sights), NEAR.ends)
    assert (free > 0.9) == is_free
    assert (stands < 0.1) == is_free or sights < 5


def test_what_is_new_stands_after_three_beams(moved):
    assert occupied(moved(4), FAR.ends)[0] > 0.9


def test_within_one_drive_it_takes_as_much_to_forget_as_to_learn():
    same = furnished_drive(*[NEAR] * SIGHTS, *[FAR] * 16)
    assert occupied(same, NEAR.ends)[0] > 0.9
