"""The cells that a ray frees: connected, nearest to the straight line, and the same in both directions.

Of the kernels in use; `test_twins` shows that maps are updated alike by their twins.
"""

from dataclasses import replace

import checks
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import gridslam.grid.tiles as tiles_module
from gridslam.grid import Evidence, TileMaps, cells_of
from gridslam.kernels import backend, reference
from gridslam.kernels.reference_update import ray_cells
from gridslam.types import LaserScan, ScanGeometry

CELL = 0.25  # a power of two: every centre of a cell is exact
EVIDENCE = Evidence(1.0, -1.0, -5.0, 5.0, 0.0)

# Up to two tiles away and over the corner of four pages, which lies at the origin.
cell = st.tuples(st.integers(-70, 70), st.integers(-70, 70))
laws = settings(max_examples=60, derandomize=True)


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


LASER = np.array([0.1, -0.05])


def beams_to(ends):
    scan = LaserScan.from_ranges(0, np.hypot(*(ends - LASER).T), ScanGeometry(np.zeros(len(ends))))
    return replace(scan.beams(0.0, np.inf), indices=np.arange(len(ends)), ends=ends, origin=LASER)


def by_brute_force(occupied, cells, reach):
    """Field (N,) at cells (N, 2) from occupied cells (M, 2)."""
    if not len(occupied):
        return np.zeros(len(cells), int)
    nearest = np.hypot(*(occupied - cells[:, None]).T).min(axis=0)
    return np.rint(255 * np.maximum(0, 1 - nearest / reach)).astype(int)


def occupied_cells(maps, row, above):
    grid = maps.occupancy(row)
    corner = np.rint(np.array(grid.origin[::-1]) / CELL).astype(int)
    return np.argwhere(grid.known & (grid.log_odds > above + 1e-3)) + corner


def field_of(maps, row, cells):
    """The field (N,), read back from the distances at the centres of cells (N, 2)."""
    centres = (cells[:, ::-1] + 0.5) * CELL
    found = maps.distances(np.array([row], np.int32), np.zeros((1, 3)), centres)[0]
    return np.rint((1 - found / maps.reach_m) * 255).astype(int)


@pytest.mark.parametrize("kernels", [backend, reference], ids=["installed", "reference"])
@pytest.mark.parametrize("reach", [1.0, 3.7, 10.5, 15.5])
@pytest.mark.parametrize("seed", range(3))
def test_field_is_the_truncated_distance_transform(kernels, reach, seed, monkeypatch):
    """After every scan, in every map; one hit occupies a cell and one miss frees it, so cells flip all the time."""
    monkeypatch.setattr(tiles_module, "backend", kernels)
    rng = np.random.default_rng(seed)
    above = 0.5
    maps = TileMaps(2, resolution_m=CELL, reach_cells=reach, evidence=Evidence(1.0, -1.0, -1.0, 1.5, above))
    window = np.array([[y, x] for y in range(-60, 60, 2) for x in range(-60, 60, 3)])
    became_free, last = 0, [set(), set()]
    for scan in range(8):
        ends = rng.normal(scale=rng.choice([1.5, 5.0]), size=(25, 2))
        poses = rng.normal(scale=[2.0, 2.0, 2.0], size=(2, 3))
        maps.update(np.arange(2, dtype=np.int32), poses, beams_to(ends))
        if scan == 4:
            maps.select(np.array([1, 1]))
        for row in range(2):
            occupied = occupied_cells(maps, row, above)
            now = set(map(tuple, occupied.tolist()))
            became_free += scan != 4 and len(last[row] - now)
            last[row] = now
            cells = np.concatenate([window, occupied + rng.integers(-16, 17, occupied.shape), occupied])
            np.testing.assert_array_equal(field_of(maps, row, cells), by_brute_force(occupied, cells, reach))
    assert became_free > 20


def test_distances_interpolate_between_centres_and_saturate():
    """Half way between an obstacle's centre and the next the distance is half a cell; far away it is the reach."""
    maps = TileMaps(1, resolution_m=CELL, reach_cells=5.0, evidence=Evidence(1.0, -1.0, -1.0, 1.5, 0.5))
    maps.update(np.zeros(1, np.int32), np.zeros((1, 3)), beams_to(np.array([[5.125, 0.125]])))
    points = np.array([[5.125, 0.125], [5.25, 0.125], [5.375, 0.125], [5.625, 0.125], [5.125, 40.0], [-900.0, 0.0]])
    found = maps.distances(np.zeros(1, np.int32), np.zeros((1, 3)), points)[0]
    # a step of the field is reach / 255, so a rounded value is half of that away
    np.testing.assert_allclose(found, [0.0, 0.125, 0.25, 0.5, 1.25, 1.25], atol=maps.reach_m / 255 / 2 + 1e-4)
    assert found[0] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(found[4:], maps.reach_m, atol=1e-6)
