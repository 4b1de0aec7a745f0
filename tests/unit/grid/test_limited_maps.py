"""Limited log-odds: what is known stays known, obstacles stay, and other owners of the tiles notice nothing."""

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.types import StoredScan

MAPPER = OccupancyGridMapping()
LIMIT = 3.0


@pytest.fixture
def maps():
    """Two maps that have most of their tiles in common, of a wall 4 m off that was seen 20 times."""
    both = MAPPER.empty(2)
    wall = StoredScan(np.stack([np.full(200, 4.0), np.linspace(-3, 3, 200)], axis=1), np.zeros(2))
    for _ in range(20):
        both.update(np.array([0], np.int32), np.zeros((1, 3)), wall)
    both.select(np.array([0, 0]))
    both.update(np.array([1], np.int32), np.array([[1.0, 0, 0.5]]), wall)
    return both


def test_known_cells_are_limited_and_the_field_is_what_it_was(maps):
    before = [maps.occupancy(row) for row in range(2)]
    fields = [maps.field(row)[0].tobytes() for row in range(2)]
    assert max(grid.log_odds.max() for grid in before) > LIMIT > -LIMIT > before[0].log_odds.min()
    other = maps.snapshot()
    maps.limit(LIMIT)
    for row, grid in enumerate(before):
        limited = maps.occupancy(row)
        np.testing.assert_array_equal(limited.known, grid.known)
        np.testing.assert_allclose(limited.log_odds, np.clip(grid.log_odds, -LIMIT, LIMIT), atol=1e-6)
        assert maps.field(row)[0].tobytes() == fields[row]
        np.testing.assert_array_equal(other.occupancy(row).log_odds, grid.log_odds)


def test_a_limit_at_which_obstacles_would_vanish_is_refused(maps):
    with pytest.raises(ArgumentError, match="log_odds: expected more than 2 nats"):
        maps.limit(2.0)
