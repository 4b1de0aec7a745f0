"""The cells that a ray frees: connected, nearest to the straight line, and the same in both directions.

Of the kernels in use; `test_twins` shows that maps are updated alike by their twins.
"""

from dataclasses import replace

import checks
import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from gridslam.grid import Evidence, TileMaps, cells_of
from gridslam.kernels.reference_update import ray_cells
from gridslam.types import LaserScan, ScanGeometry

CELL = 0.25  # a power of two: every centre of a cell is exact
EVIDENCE = Evidence(1.0, -1.0, -5.0, 5.0, 0.0)

# Up to two tiles away and over the corner of four pages, which lies at the origin.
cell = st.tuples(st.integers(-70, 70), st.integers(-70, 70))
laws = settings(max_examples=150, deadline=None, derandomize=True)


def seen(start, end):
    """The cells [y, x] that one beam from `start` to `end` frees, and those that it hits, as the maps store them."""
    maps = TileMaps(1, resolution_m=CELL, reach_cells=1.0, evidence=EVIDENCE)
    start, end = np.array(start), np.array(end)
    pose = np.array([[*(start[::-1] + 0.5) * CELL, 0.0]])
    ends = (end - start)[None, ::-1] * CELL
    scan = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry([0.0]))
    beam = replace(scan.beams(0.0, np.inf), indices=np.zeros(1, int), ends=ends)
    maps.update(np.zeros(1, np.int32), pose, beam)
    grid = maps.occupancy(0)
    corner = cells_of(np.array(grid.origin) + CELL / 2, CELL)
    return [np.argwhere(grid.known & sign) + corner for sign in (grid.log_odds < 0, grid.log_odds > 0)]


@laws
@given(start=cell, end=cell)
def test_a_ray_frees_a_connected_line_and_hits_its_end(start, end):
    """It starts at the laser, takes one step of the longer axis at a time, never turns back, ends before the hit."""
    free, hit = seen(start, end)
    assert hit.tolist() == [list(end)]
    checks.ray_is_connected(free, start, end)


@laws
@given(start=cell, end=cell)
def test_cells_lie_within_half_a_cell_of_the_straight_line(start, end):
    """On the shorter axis, in whole numbers: 2 |n (cell - start) - i d| <= n."""
    assume(start != end)
    checks.ray_is_straight(seen(start, end)[0], start, end)


@laws
@given(start=cell, end=cell)
def test_a_ray_back_passes_the_same_cells(start, end):
    there, back = (np.concatenate(seen(*pair)) for pair in ((start, end), (end, start)))
    assert set(map(tuple, there.tolist())) == set(map(tuple, back.tolist()))


@laws
@given(start=cell, end=cell, shift=cell)
def test_a_shift_by_whole_cells_shifts_the_ray(start, end, shift):
    there = np.concatenate(seen(start, end)) + shift
    shifted = np.concatenate(seen(np.add(start, shift), np.add(end, shift)))
    assert set(map(tuple, there.tolist())) == set(map(tuple, shifted.tolist()))


@laws
@given(start=cell, ends=st.lists(cell, max_size=5))
def test_rays_of_the_twin_are_those_of_the_maps(start, ends):
    """`ray_cells` gives the rays one after the other, each in its order; a ray of length 0 has no cell."""
    table = np.array(ends, dtype=np.int64).reshape(-1, 2)
    cells = ray_cells(np.array(start), table)
    expected = [checks.along(seen(start, end)[0], start, end) for end in ends]
    np.testing.assert_array_equal(cells, np.concatenate([np.zeros((0, 2), int), *expected]))
