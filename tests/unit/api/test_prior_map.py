"""A given map becomes a piece of a session: drawn from its key scans it is the same map."""

import numpy as np
import pytest

from gridslam.api.prior_map import piece_of_map
from gridslam.config import Configuration
from gridslam.errors import ArgumentError
from gridslam.types import OccupancyGrid

CELL_M = 0.05


def floor(height=160, width=240):
    """Two rooms with a door between them, walls of 10 cm, and nothing known around: 12 m x 8 m."""
    occupied = np.zeros((height, width), np.bool_)
    occupied[20:-20, 20:-20] = True
    free = np.zeros_like(occupied)
    free[22:-22, 22:118] = free[22:-22, 122:-22] = free[70:90, 118:122] = True
    occupied &= ~free
    log_odds = np.where(free, -4.0, np.where(occupied, 4.0, 0.0)).astype(np.float32)
    return OccupancyGrid(log_odds, free | occupied, CELL_M, (-3.0, 2.0)), free, occupied


def test_the_piece_draws_the_map_that_was_given():
    grid, free, occupied = floor()
    mapper = Configuration().mapper
    drawn = piece_of_map(grid).build_map(mapper).occupancy(0)
    up, across = np.rint((np.array(grid.origin) - drawn.origin) / CELL_M).astype(int)[::-1]
    height, width = grid.shape
    known = np.zeros_like(free)
    log_odds = np.zeros_like(grid.log_odds)
    top, right = min(height, drawn.shape[0] - up), min(width, drawn.shape[1] - across)
    low, left = max(-up, 0), max(-across, 0)
    known[low:top, left:right] = drawn.known[low + up : top + up, left + across : right + across]
    log_odds[low:top, left:right] = drawn.log_odds[low + up : top + up, left + across : right + across]
    assert np.mean(known[free] & (log_odds[free] < 0)) > 0.99
    inner = np.zeros_like(occupied)  # of a wall of two cells the one that is seen
    inner[21:-21, 21:-21] = True
    inner[22:-22, 22:118] = inner[22:-22, 122:-22] = False
    inner[:, 118:122] = False
    assert np.mean(log_odds[inner] > 0) > 0.95
    assert not known[~free & ~occupied].any()  # no beam has passed a wall


def test_beams_end_where_the_known_map_does():
    """A room without one of its walls: beams that would leave it are left out."""
    grid = floor()[0]
    known = grid.known.copy()
    known[:, 200:] = False
    piece = piece_of_map(OccupancyGrid(grid.log_odds, known, CELL_M, grid.origin))
    ends = np.concatenate([piece.scans.key(k).ends + piece.poses[k, :2] for k in range(len(piece))])
    assert ends[:, 0].max() < -3.0 + 200 * CELL_M


@pytest.mark.parametrize("range_max_m", [0.0, -1.0, float("nan")])
def test_a_range_that_is_none_is_refused(range_max_m):
    with pytest.raises(ArgumentError, match="range_max_m: expected a range above 0 m"):
        piece_of_map(floor()[0], range_max_m)


def test_a_map_without_obstacles_is_refused():
    free = np.ones((40, 40), np.bool_)
    with pytest.raises(ArgumentError, match="occupied"):
        piece_of_map(OccupancyGrid(np.full((40, 40), -4, np.float32), free, CELL_M, (0.0, 0.0)))
    log_odds = np.full((40, 40), -4, np.float32)
    log_odds[0, 0] = 4.0
    free[1:3, :3] = free[:3, 1:3] = False
    with pytest.raises(ArgumentError, match="a free place from which an obstacle is seen"):
        piece_of_map(OccupancyGrid(log_odds, free, CELL_M, (0.0, 0.0)), 0.1)
