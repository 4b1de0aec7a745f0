"""Counts of beams: against every ray drawn by itself, whatever the scans' order, and what fades of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.kernels.reference_update import ray_cells
from gridslam.mapping import OccupancyGridMapping
from gridslam.mapping.beam_counts import BeamCounts, bayes_map, counting_map
from gridslam.models import InverseSensorModel
from gridslam.types import StoredScan
from support.same_map import assert_same_map

WIDE = InverseSensorModel.from_log_odds(2.4, -0.4, log_odds_min=-150.0, log_odds_max=150.0)
"""Clamps that no test here reaches; 2.4 and 0.4 are whole steps of the map in which SLAM keeps them."""


def drawn(seed: int, scans: int, beams: int = 40):
    """Scans of an imagined world: poses (scans, 3) and ends; some end beyond the first tiles, in all directions."""
    rng = np.random.default_rng(seed)
    poses = rng.uniform([-3, -3, -np.pi], [3, 3, np.pi], (scans, 3))
    return [(pose, StoredScan(rng.uniform(-4, 4, (beams, 2)), np.array([0.1, 0.0]))) for pose in poses]


def counted(scans, **how) -> BeamCounts:
    counts = BeamCounts(0.1, **how)
    for pose, beams in scans:
        counts.add(pose, beams)
    return counts


def by_cell(counts: BeamCounts) -> dict[tuple[int, int], tuple[float, float]]:
    slots, (row, column) = counts.table()
    hits, misses = counts.unfold(slots)
    return {(y + row, x + column): (hits[y, x], misses[y, x]) for y, x in np.argwhere(hits + misses > 0).tolist()}


def test_every_ray_is_counted_once():
    scans, expected = drawn(0, 12), {}
    for pose, beams in scans:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        world = np.array([[c, -s], [s, c]])
        start = np.floor((pose[:2] + world @ beams.origin)[::-1] / 0.1).astype(np.int64)
        ends = np.floor((pose[:2] + beams.ends @ world.T)[:, ::-1] / 0.1).astype(np.int64)
        hit = {tuple(cell) for cell in ends.tolist()}
        for end in ends:
            hits, misses = expected.get(tuple(end.tolist()), (0, 0))
            expected[tuple(end.tolist())] = hits + 1, misses
            for cell in map(tuple, ray_cells(start, end[None]).tolist()):
                if cell not in hit:
                    hits, misses = expected.get(cell, (0, 0))
                    expected[cell] = hits, misses + 1
    assert by_cell(counted(scans)) == expected


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.permutations(range(8)))
def test_the_order_of_the_scans_does_not_matter(seed, order):
    scans = drawn(seed, 8)
    first, second = counted(scans), counted([scans[k] for k in order])
    for ours, theirs in zip(*(counts.unfold(counts.table()[0]) for counts in (first, second)), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert first.table()[1] == second.table()[1]
    for model in (counting_map, lambda counts: bayes_map(counts, InverseSensorModel())):
        assert_same_map(model(first), model(second))


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 10**6))
def test_the_sum_is_what_the_filter_of_slam_ends_with(seed):
    scans, mapper = drawn(seed, 10), OccupancyGridMapping(resolution_m=0.1, inverse_sensor=WIDE)
    maps = mapper.empty(1)
    for pose, beams in scans:
        maps.update(np.zeros(1, np.int32), pose[None], beams)
    assert_same_map(maps.occupancy(0), bayes_map(counted(scans), WIDE))


def test_the_clamps_hold_for_the_sum():
    (pose, beams), sensor = drawn(1, 1)[0], InverseSensorModel()
    grid = bayes_map(counted([(pose, beams)] * 300), sensor)
    assert (grid.log_odds.min(), grid.log_odds.max()) == (sensor.log_odds_min, sensor.log_odds_max)
    assert set(np.unique(grid.log_odds[grid.known])) == {sensor.log_odds_min, sensor.log_odds_max}


def test_the_counting_model_in_closed_form():
    counts = counted(drawn(2, 30))
    hits, misses = counts.unfold(counts.table()[0])
    grid, seen = counting_map(counts), hits + misses > 0
    np.testing.assert_array_equal(grid.known, seen)
    np.testing.assert_allclose(grid.probability[seen], hits[seen] / (hits + misses)[seen], atol=2e-7)
    assert {0.0, 1.0} <= set(np.rint(1e6 * grid.probability[seen]) / 1e6)  # what was never, and always reflected


def straight(*ranges: float) -> StoredScan:
    return StoredScan(np.array([[r, 0.0] for r in ranges]), np.zeros(2))


def near(counts: BeamCounts, x: float) -> tuple[float, float]:
    return by_cell(counts).get((0, int(x / 0.1)), (0.0, 0.0))


POSE = np.array([0.05, 0.05, 0.0])


def test_what_was_seen_fades_by_scans_that_see_it():
    """A door at 2 m that opens: n scans of half-life h leave 2^(-n/h) of the hits."""
    counts = BeamCounts(0.1, half_life_scans=5)
    for _ in range(20):
        counts.add(POSE, straight(2.0))
    kept = 0.5 ** (1 / 5)
    full = (1 - kept**20) / (1 - kept)
    assert near(counts, 2.05) == pytest.approx((full, 0.0))
    for _ in range(10):
        counts.add(POSE, straight(3.0))
    hits, misses = near(counts, 2.05)
    assert hits == pytest.approx(full / 4)
    assert misses == pytest.approx((1 - kept**10) / (1 - kept))
    assert near(counts, 1.05) == pytest.approx((0.0, (1 - kept**30) / (1 - kept)))


def test_a_door_that_opened_is_open_only_with_decay():
    for half_life, occupied in ((None, True), (10, False)):
        counts = BeamCounts(0.1, half_life)
        for r in [2.0] * 100 + [3.0] * 30:
            counts.add(POSE, straight(r))
        for grid in (bayes_map(counts, WIDE), counting_map(counts)):
            row, column = (round(-start / 0.1) for start in grid.origin[::-1])
            assert (grid.log_odds[row, column + 20] > 0) == occupied
