"""Saved pieces: thinned with their drives and stamps, and frozen."""

from dataclasses import replace

import numpy as np

from gridslam.config import Configuration
from gridslam.io.sessions.drives import Drive, SavedPiece
from gridslam.slam.full_slam.full_trajectory import TrackedScans, full_trajectories
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.types import StoredScan

MAPPER = Configuration().mapper
ANGLES = np.linspace(-np.pi, np.pi, 60, endpoint=False)
ROOM = StoredScan(3.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1), np.zeros(2))
SCANS = 10


def drive(number):
    """A drive of ten key scans in one room."""
    archive, graph = ScanArchive(), KeyGraph()
    for key in range(SCANS):
        pose = np.array([0.1 * key, 0.0, 0.0])
        archive.append(ROOM, pose, is_key=True)
        graph.extend(pose, pose, (1e-4, 1e-6))
    scans = TrackedScans(np.arange(SCANS), np.tile([0.1, 0.0, 0.0], (SCANS, 1)))
    return MapPiece(archive, graph), Drive(f"day{number}", (), 1000 * number + np.arange(SCANS), scans)


def saved(count):
    piece, first = drive(0)
    drives = [first]
    for number in range(1, count):
        later, own = drive(number)
        scans = own.scans._replace(keys=len(piece) + own.scans.keys)
        source = ConstraintSource.RECOGNIZED, True
        closure = Constraint(len(piece) - 1, 0, np.array([-0.9, 0.0, 0.0]), 1e4 * np.eye(3), *source)
        piece = piece.append(later, PieceMatch(later.poses, [closure]))
        drives.append(replace(own, scans=scans))
    return SavedPiece(piece, tuple(drives))


def test_drives_of_which_nothing_is_left_are_left_out_and_the_others_keep_their_stamps():
    thinned = saved(5).thin(MAPPER)
    assert [drive.name for drive in thinned.drives] == ["day3", "day4"]
    np.testing.assert_array_equal(thinned.stamps_ns, [*range(3000, 3010), *range(4000, 4010)])
    assert [drive.scans.keys[0] for drive in thinned.drives] == [0, 10]
    poses = full_trajectories(thinned.piece.poses, thinned.tracked_scans)
    np.testing.assert_array_equal(poses, thinned.piece.poses)
    assert list(thinned.split(poses)) == ["day3", "day4"]


def test_a_saved_piece_is_frozen_where_its_scans_lie_and_its_graph_is_released():
    piece = saved(2)
    poses = np.random.default_rng(0).normal(size=(len(piece.stamps_ns), 3))
    frozen = piece.freeze(poses)
    assert frozen.piece.graph.frozen == 2 * SCANS
    assert np.array_equal(np.concatenate([drive.scans.poses for drive in frozen.drives]), poses)
    assert [drive.name for drive in frozen.drives] == [drive.name for drive in piece.drives]
    assert piece.piece.graph.frozen == 0
