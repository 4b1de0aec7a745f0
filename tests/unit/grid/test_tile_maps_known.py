"""What a map knows cell by cell, and other owners of some of its rows."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.grid import Evidence, TileMaps, cells_of
from gridslam.types import LaserScan, ScanGeometry

CELL = 0.1
ROWS = np.arange(3, dtype=np.int32)


def beams_to(ends):
    scan = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends))))
    return replace(scan.beams(0.0, np.inf), indices=np.arange(len(ends)), ends=ends)


def draw(maps, rng, rows=ROWS):
    poses = rng.normal(scale=[10.0, 10.0, 2.0], size=(len(rows), 3))
    maps.update(rows, poses, beams_to(rng.normal(scale=4, size=(40, 2))))


def three_maps():
    """Three maps, some 50 m wide, about the corner of four pages, that share a scan and differ in others."""
    rng = np.random.default_rng(0)
    made = TileMaps(3, resolution_m=CELL, reach_cells=4.0, evidence=Evidence(2.0, -0.4, -9.0, 9.0, 1.0))
    draw(made, rng, ROWS[:1])
    made.select(np.zeros(3, np.int64))
    for _ in range(3):
        draw(made, rng)
    return made


@pytest.fixture
def maps():
    return three_maps()


def contents(maps):
    return [(grid.origin, grid.log_odds.tobytes()) for grid in (maps.occupancy(row) for row in range(len(maps)))]


@pytest.mark.parametrize("row", [0, 1, 2])
def test_known_is_what_the_rectangle_knows_and_nothing_outside_of_it(maps, row):
    grid = maps.occupancy(row)
    rng = np.random.default_rng(row)
    side = CELL * np.array(grid.known.shape[::-1])
    points = np.array(grid.origin) + rng.uniform(-0.5, 1.5, (20000, 2)) * side
    points[:2000] = CELL * np.round(points[:2000] / CELL)  # on borders of cells
    points[:3] = [[1e6, 0.0], [0.0, -1e6], [-1e6, 1e6]]  # far outside of the tables
    # the rectangle's corner is a whole number of cells: counted from there, borders would be rounded otherwise
    cells = cells_of(points, CELL) - np.rint(np.array(grid.origin[::-1]) / CELL).astype(int)
    inside = ((cells >= 0) & (cells < grid.known.shape)).all(axis=1)
    expected = np.zeros(len(points), bool)
    expected[inside] = grid.known[tuple(cells[inside].T)]
    np.testing.assert_array_equal(maps.is_known(row, points), expected)
    assert 100 < expected.sum() < 0.5 * len(points)
    assert np.count_nonzero(~inside) > 1000


@pytest.mark.parametrize("rows", [[1], [2, 0], [1, 1, 1, 1], [0, 1, 2]])
def test_a_snapshot_of_rows_holds_them_and_either_side_writes_for_itself(maps, rows):
    before = contents(maps)
    twin = maps.snapshot(np.array(rows))
    assert len(twin) == len(rows)
    expected = [before[row] for row in rows]
    assert contents(twin) == expected
    rng = np.random.default_rng(1)
    draw(maps, rng)
    assert contents(twin) == expected
    after = contents(maps)
    draw(twin, rng, np.arange(len(rows), dtype=np.int32))
    assert contents(maps) == after
    assert all(one != other for one, other in zip(contents(twin), expected, strict=True))
