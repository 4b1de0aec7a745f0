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
