from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.evaluation import compare_maps
from gridslam.types import OccupancyGrid


def grid(log_odds, known=None, origin=(0.0, 0.0), resolution_m=0.05):
    values = np.asarray(log_odds, dtype=np.float32)
    return OccupancyGrid(values, np.ones(values.shape, bool) if known is None else known, resolution_m, origin)


def room(seed=0):
    rng = np.random.default_rng(seed)
    return grid(rng.choice([-3.0, 4.0], (20, 30)), rng.random((20, 30)) < 0.8)


@pytest.mark.parametrize(("rows", "columns"), [(0, 0), (3, -4), (-5, 2), (-2, -2), (6, 7)])
def test_a_window_of_the_map_agrees_where_it_lies(rows, columns):
    whole = room()
    padded = np.pad(whole.log_odds, 10)
    known = np.pad(whole.known, 10)
    window = (slice(10 + rows, 30 + rows), slice(10 + columns, 40 + columns))
    # An origin off by a third of a cell is still the same cell.
    part = grid(padded[window], known[window], (0.05 * columns + 0.016, 0.05 * rows - 0.016))
    got = compare_maps(part, whole)
    inside = known[window].sum()
    assert (got.cells, got.agreement) == (inside, 1.0)
    assert got.coverage == pytest.approx(inside / whole.known.sum())


def test_numbers_by_hand():
    # Probabilities 3/4 and 1/4: three of four cells agree; centred [+,+,-,-] and [+,-,-,-] correlate by 1/sqrt(3).
    odds = math.log(3)
    got = compare_maps(grid([[odds, odds], [-odds, -odds]]), grid([[odds, -odds], [-odds, -odds]]))
    assert got.agreement == 0.75
    assert got.correlation == pytest.approx(1 / math.sqrt(3), rel=1e-6)


@pytest.mark.parametrize(
    "other", [grid([[1]], resolution_m=0.1), grid([[1]], origin=(5.0, 0.0)), grid([[1]], np.zeros((1, 1), bool))]
)
def test_maps_that_cannot_be_compared_raise(other):
    with pytest.raises(ArgumentError, match="estimate"):
        compare_maps(other, grid([[1.0, -1.0]]))
