"""The occupancy grid as a binary Bayes filter, and its export as a rectangle."""

from dataclasses import replace

import checks
import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.grid import LOG_ODDS_UNIT, Evidence, TileMaps, cells_of
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


@pytest.mark.parametrize(
    "values",
    [(0.0, -0.4, -9, 9, 1), (0.4, 0.0, -9, 9, 1), (0.4, -0.4, 0, 9, 1), (0.4, -0.4, -9, 0, 1), (1, -1, -400, 9, 1)],
)
def test_evidence_that_could_not_be_stored_is_refused(values):
    with pytest.raises(ArgumentError, match="Evidence"):
        Evidence(*values)


def maps_that_saw(*hits):
    maps = TileMaps(2, resolution_m=CELL, reach_cells=4.0, evidence=Evidence(2.0, -0.4, -9.0, 9.0, 1.0))
    ends = np.array(hits, dtype=np.float64)
    beams = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends)))).beams(0.0, np.inf)
    maps.update(ROW, np.zeros((1, 3)), replace(beams, indices=np.arange(len(ends)), ends=ends))
    return maps


def test_the_field_falls_with_the_distance_to_the_nearest_obstacle():
    """Hits at (-71, 33) and (15, -52), in cells; 255 there, 0 from four cells away on."""
    maps = maps_that_saw((-7.05, 3.35), (1.55, -5.15))
    field, corner = maps.field(0)
    assert field.dtype == np.uint8
    y, x = np.mgrid[: field.shape[0], : field.shape[1]] + np.array(corner)[:, None, None]
    away = np.minimum(np.hypot(x + 71, y - 33), np.hypot(x - 15, y + 52))
    np.testing.assert_array_equal(field, np.rint(255 * np.maximum(0, 1 - away / 4)).astype(np.uint8))
    assert (field == 255).sum() == 2


def maps_with_rows(*hits):
    maps = TileMaps(1, resolution_m=CELL, reach_cells=4.0, evidence=Evidence(2.0, -0.4, -9.0, 9.0, 1.0))
    ends = np.array(hits, dtype=np.float64)
    beams = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends)))).beams(0.0, np.inf)
    beams = replace(beams, indices=np.arange(len(ends)), ends=ends)
    maps.update(np.zeros(1, np.int32), np.zeros((1, 3)), beams)
    return maps, beams


@pytest.mark.parametrize(("first", "last"), [(0, 1), (5, 40), (31, 33), (64, 64), (0, 96), (90, 128)])
def test_rows_are_those_of_the_whole_map(first, last):
    maps, _ = maps_with_rows((5.05, 3.35), (-2.55, -5.15))
    tiled, whole = maps.tiled(0), maps.occupancy(0)
    assert tiled.shape == whole.shape == whole.known.shape
    assert tiled.origin == whole.origin
    assert whole.known.any()
    assert not whole.known.all()
    for rows in (tiled.rows(first, last), whole.rows(first, last)):
        np.testing.assert_array_equal(rows.log_odds, whole.log_odds[first:last])
        np.testing.assert_array_equal(rows.known, whole.known[first:last])
        assert rows.origin == pytest.approx((whole.origin[0], whole.origin[1] + first * CELL))
