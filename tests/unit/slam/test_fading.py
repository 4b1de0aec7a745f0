"""What has gone fades, and what is new appears, from one drive to the next and not within one."""

import numpy as np
import pytest

from gridslam.config import Configuration
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.types import StoredScan

SIGHTS = 30
"""Of a wall in one drive, far more than it takes to be certain."""
NEAR = StoredScan(np.stack([np.full(81, 3.0), np.linspace(-1, 1, 81)], axis=1), np.zeros(2))
FAR = StoredScan(np.stack([np.full(81, 5.0), np.linspace(-1.6, 1.6, 81)], axis=1), np.zeros(2))


def drive(*scans):
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
    """A wall that stood 3 m off for a whole drive, and 5 m off for a few sights of the next one."""

    def of(sights):
        later = drive(*[FAR] * sights)
        return drive(*[NEAR] * SIGHTS).append(later, PieceMatch(later.poses, []))

    return of


@pytest.mark.parametrize(("sights", "is_free"), [(3, False), (16, True)])
def test_what_has_gone_is_free_after_few_beams_of_the_next_drive(moved, sights, is_free):
    stands, free = occupied(moved(sights), NEAR.ends)
    assert (free > 0.9) == is_free
    assert (stands < 0.1) == is_free or sights < 5


def test_what_is_new_stands_after_three_beams(moved):
    assert occupied(moved(4), FAR.ends)[0] > 0.9


def test_within_one_drive_it_takes_as_much_to_forget_as_to_learn():
    same = drive(*[NEAR] * SIGHTS, *[FAR] * 16)
    assert occupied(same, NEAR.ends)[0] > 0.9
