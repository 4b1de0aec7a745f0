"""Whether two maps say the same of the same places."""

from __future__ import annotations

import numpy as np

from gridslam.types import OccupancyGrid


def assert_same_map(ours: OccupancyGrid, theirs: OccupancyGrid) -> None:
    """Known cells are the same ones, with equal log-odds (1e-5); either map may have a margin of unknown cells."""
    assert ours.resolution_m == theirs.resolution_m
    corners = [np.rint(np.array(grid.origin)[::-1] / grid.resolution_m).astype(int) for grid in (ours, theirs)]
    cells = [np.argwhere(grid.known) + corner for grid, corner in zip((ours, theirs), corners, strict=True)]
    np.testing.assert_array_equal(*cells)
    np.testing.assert_allclose(ours.log_odds[ours.known], theirs.log_odds[theirs.known], atol=1e-5)
