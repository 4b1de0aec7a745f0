"""The occupancy grid as a binary Bayes filter, and its export as a rectangle."""

from __future__ import annotations

from dataclasses import replace

import checks
import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.grid import LOG_ODDS_UNIT, Evidence, TileMaps, cell_centres, cells_of
from gridslam.models import InverseSensorModel
from gridslam.types import LaserScan, ScanGeometry

ROW = np.zeros(1, np.int32)
CELL = 0.1


def evidence_of(model):
    return Evidence(
        model.log_odds_hit, model.log_odds_miss, model.log_odds_min, model.log_odds_max, model.log_odds_occupied
    )


def see(maps, ends, pose=(0.05, 0.05, 0.0)):
    """Insert beams from the base's origin to `ends` (B, 2), world axes."""
    ends = np.array(ends, dtype=np.float64).reshape(-1, 2)
    scan = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends))))
    maps.update(ROW, np.array([pose]), replace(scan.beams(0.0, np.inf), indices=np.arange(len(ends)), ends=ends))


def at(grid, x, y):
    row, column = cells_of(np.array([x, y]) - grid.origin, grid.resolution_m)
    return row, column


@pytest.mark.parametrize(("true_occupied", "true_free", "measured"), checks.BAYES_CASES)
def test_one_cell_follows_bayes_rule(true_occupied, true_free, measured):
    """The cell's belief equals Bayes' rule, applied with the four probabilities to one measurement after the other."""
    model = InverseSensorModel(true_occupied, 1 - true_occupied, 1 - true_free, true_free)
    maps = TileMaps(1, resolution_m=CELL, reach_cells=3.0, evidence=evidence_of(model))

    def log_odds_after(seen):
        see(maps, [(1.0 if seen[-1] == "h" else 2.0, 0.0)])  # the beam ends in the cell, or passes through it
        grid = maps.occupancy(0)
        cell = at(grid, 1.05, 0.05)
        assert grid.known[cell]
        assert grid.probability[cell] == pytest.approx(1 / (1 + np.exp(-grid.log_odds[cell])), abs=1e-6)
        return float(grid.log_odds[cell])

    # each measurement is stored to the nearest step of log-odds
    checks.cell_follows_bayes_rule(log_odds_after, model, measured, rounding=LOG_ODDS_UNIT / 2)


def test_log_odds_do_not_depend_on_the_order_of_scans_away_from_the_clamps():
    rng = np.random.default_rng(3)
    evidence = Evidence(0.9, -0.4, -163, 163, 1.0)
    scans = [(rng.normal(scale=2, size=(12, 2)), rng.normal(scale=0.5, size=3)) for _ in range(10)]
    grids = []
    for order in (range(10), rng.permutation(10), range(9, -1, -1)):
        maps = TileMaps(1, resolution_m=CELL, reach_cells=3.0, evidence=evidence)
        for i in order:
            see(maps, *scans[i])
        grids.append(maps.occupancy(0))
    for grid in grids[1:]:
        assert grid.origin == grids[0].origin
        np.testing.assert_array_equal(grid.known, grids[0].known)
        np.testing.assert_array_equal(grid.log_odds, grids[0].log_odds)


def test_clamps_hold_and_can_be_left_again():
    maps = TileMaps(1, resolution_m=CELL, reach_cells=3.0, evidence=Evidence(0.9, -0.4, -1.0, 2.0, 1.0))

    def log_odds():
        grid = maps.occupancy(0)
        return grid.log_odds[at(grid, 1.05, 0.05)]

    for _ in range(5):
        see(maps, [(1.0, 0.0)])
    assert log_odds() == pytest.approx(2.0)
    see(maps, [(2.0, 0.0)])
    assert log_odds() == pytest.approx(1.6)
    for _ in range(10):
        see(maps, [(2.0, 0.0)])
    assert log_odds() == pytest.approx(-1.0)
    see(maps, [(1.0, 0.0)])
    assert log_odds() == pytest.approx(-0.1)


def test_a_cell_in_which_a_beam_ends_is_not_freed_by_another_beam_of_the_scan():
    maps = TileMaps(1, resolution_m=CELL, reach_cells=3.0, evidence=Evidence(0.9, -0.4, -9.0, 9.0, 1.0))
    see(maps, [(1.0, 0.0), (2.0, 0.0), (1.0, 0.0), (3.0, 0.0)])
    grid = maps.occupancy(0)
    expected = {1.05: 1.8, 2.05: 0.9, 3.05: 0.9, 0.55: -1.6, 1.55: -0.8, 2.55: -0.4}
    for x, value in expected.items():
        assert grid.log_odds[at(grid, x, 0.05)] == pytest.approx(value)


def test_export_has_its_origin_at_the_lower_left_and_rows_along_y():
    maps = TileMaps(1, resolution_m=CELL, reach_cells=3.0, evidence=Evidence(2.0, -0.4, -9.0, 9.0, 1.0))
    hits = np.array([[1.37, -2.91], [-4.02, 0.33], [0.51, 7.77], [-0.01, -0.01]])
    for hit in hits:
        see(maps, [hit], (0.0, 0.0, 0.0))
    grid = maps.occupancy(0)
    occupied = np.argwhere(grid.log_odds > 1)
    centres = cell_centres(occupied, CELL) + grid.origin
    assert len(occupied) == len(hits)
    for hit in hits:
        assert (np.abs(centres - hit).max(axis=1) <= CELL / 2 + 1e-9).sum() == 1
    assert grid.resolution_m == CELL
    np.testing.assert_allclose(grid.origin, np.rint(np.array(grid.origin) / CELL) * CELL)
    assert grid.origin[0] <= hits[:, 0].min()
    assert grid.origin[1] <= hits[:, 1].min()
    assert (np.array(grid.origin) + np.array(grid.log_odds.shape[::-1]) * CELL >= hits.max(axis=0)).all()


@pytest.mark.parametrize(
    "values",
    [(0.0, -0.4, -9, 9, 1), (0.4, 0.0, -9, 9, 1), (0.4, -0.4, 0, 9, 1), (0.4, -0.4, -9, 0, 1), (1, -1, -400, 9, 1)],
)
def test_evidence_that_could_not_be_stored_is_refused(values):
    with pytest.raises(ArgumentError, match="Evidence"):
        Evidence(*values)
