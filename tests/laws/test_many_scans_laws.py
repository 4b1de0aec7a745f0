"""Many scans in one call give what one call for each gives, and so do the NumPy twins."""

import numpy as np
import pytest

import gridslam.grid.tiles as tiles_module
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import transform_points
from gridslam.grid import Evidence, TileMaps
from gridslam.grid.scan_batch import ScanBatch, Weighing
from gridslam.kernels import reference
from gridslam.kernels.reference_update import unknown_of
from gridslam.types import StoredScan

compiled = pytest.importorskip("gridslam.kernels._compiled")

CELL = 0.05
ROW = np.zeros(1, np.int32)
BACKENDS = pytest.mark.parametrize("backend", [compiled, reference], ids=["compiled", "reference"])


def empty(evidence=None, most_tiles=500_000):
    """One map; of the evidence that is given by default cells become free again after few scans."""
    evidence = evidence or Evidence(1.0, -1.0, -2.0, 2.0, 0.0)
    return TileMaps(1, resolution_m=CELL, reach_cells=10.5, evidence=evidence, most_tiles=most_tiles)


def random_scans(rng, count=12):
    """Scans of one crooked room, each from another pose; two see nothing, one sees far, the last is not near."""
    bearings = np.linspace(-np.pi, np.pi, 50, endpoint=False)
    scans = []
    poses = rng.normal(scale=[0.8, 0.8, 2.0], size=(count, 3))
    poses[-1, 0] += 300.0
    for k in range(count):
        ranges = rng.uniform(1.0, 4.0) * (1 + 0.3 * np.sin(3 * bearings)) * (30.0 if k == 4 else 1.0)
        ends = ranges[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
        scans.append(StoredScan(ends[: 0 if k in {2, 7} else len(ends)], rng.normal(scale=0.1, size=2)))
    return poses, scans


def assert_same(one, other):
    """The same tiles in the same places; the tables about them may reach farther."""
    assert one.tile_ids(0)[1] == other.tile_ids(0)[1]
    np.testing.assert_array_equal(one.tile_ids(0)[0] > 0, other.tile_ids(0)[0] > 0)
    for name in ("log_odds", "field"):
        np.testing.assert_array_equal(one.to_arrays()[name], other.to_arrays()[name], err_msg=name)


@BACKENDS
@pytest.mark.parametrize("seed", range(6))
def test_scans_drawn_together_give_the_map_of_scans_drawn_one_by_one(seed, backend, monkeypatch):
    """To the last byte, tiles and their numbers included, though the field follows only in the end."""
    rng = np.random.default_rng(seed)
    poses, scans = random_scans(rng)
    one_by_one = empty()
    for pose, scan in zip(poses, scans, strict=True):
        one_by_one.update(ROW, pose[None], scan)
    became_free = one_by_one._arena.field != 255
    assert (became_free & (one_by_one._arena.log_odds > unknown_of(one_by_one._arena.log_odds))).any()
    monkeypatch.setattr(tiles_module, "backend", backend)
    together = empty()
    together.draw(poses, ScanBatch.of(scans), 0, len(scans))
    assert_same(together, one_by_one)


@BACKENDS
def test_drawing_leaves_what_another_map_shares(backend, monkeypatch):
    rng = np.random.default_rng(3)
    poses, scans = random_scans(rng)
    monkeypatch.setattr(tiles_module, "backend", backend)
    maps = empty()
    maps.draw(poses, ScanBatch.of(scans), 0, 5)
    kept = maps.snapshot()
    before = kept.to_arrays()
    maps.draw(poses, ScanBatch.of(scans), 5, len(scans))
    for name, array in before.items():
        np.testing.assert_array_equal(array, kept.to_arrays()[name], err_msg=name)
    alone = empty()
    alone.draw(poses, ScanBatch.of(scans), 0, len(scans))
    assert_same(maps, alone)


@BACKENDS
def test_more_tiles_than_there_may_be_are_refused_as_for_one_scan(backend, monkeypatch):
    rng = np.random.default_rng(0)
    poses, scans = random_scans(rng)
    monkeypatch.setattr(tiles_module, "backend", backend)
    together = empty(most_tiles=60)
    with pytest.raises(ArgumentError, match=r"mapper\.max_tiles"):
        together.draw(poses, ScanBatch.of(scans), 0, len(scans))
    few = empty(most_tiles=60)
    drawn = 0
    while True:
        try:
            few.update(ROW, poses[drawn : drawn + 1], scans[drawn])
        except ArgumentError:
            break
        drawn += 1
    assert 0 < drawn < len(scans) - 1
    np.testing.assert_array_equal(together.tile_ids(0)[0] > 0, few.tile_ids(0)[0] > 0)


@BACKENDS
def test_scans_are_weighed_by_what_was_drawn_before_them(backend, monkeypatch):
    """The weights are those of the map of exactly the scans that count, and -1 where it knows nothing."""
    rng = np.random.default_rng(1)
    poses, scans = random_scans(rng)
    batch = ScanBatch.of(scans)
    after = np.array([0, 0, 0, 1, 1, 3, 3, 3, 6, 8, 11, 11])
    monkeypatch.setattr(tiles_module, "backend", backend)
    maps = empty()
    weighing = Weighing.of(batch, after, 0.1)
    maps.draw(poses, batch, 0, len(scans), weighing)
    for k, (pose, scan) in enumerate(zip(poses, scans, strict=True)):
        own = weighing.weights[batch.starts[k] : batch.starts[k + 1]]
        if not after[k]:
            assert (own == -1).all()
            continue
        seen = empty()
        seen.draw(poses, batch, 0, int(after[k]))
        known = seen.is_known(0, transform_points(pose, scan.ends)) if len(scan) else np.zeros(0, np.bool_)
        away = seen.distances(ROW, pose[None], scan.ends)[0]
        np.testing.assert_array_equal(own >= 0, known)
        np.testing.assert_allclose(own[known], 1 / (1 + np.square(away[known] / 0.1)), rtol=1e-5)
    assert (weighing.weights > 0.2).any()


def test_the_twins_agree_on_where_there_are_too_few_tiles():
    """Both stop before the same scan, with the same tiles taken."""
    rng = np.random.default_rng(5)
    poses, scans = random_scans(rng, 8)
    batch = ScanBatch.of(scans)
    results = []
    for kernels in (compiled, reference):
        maps = empty()
        maps._arena.reserve(30, 400)
        maps._cover(poses, batch)
        arena = maps._arena
        results.append(
            kernels.draw_scans(
                *maps._view,
                *(arena.page_refs, arena.tile_refs, *arena.free_ids, poses, *batch, 0, len(scans), CELL),
                *(maps._steps, maps._cone, 150, np.zeros(0, np.int64), np.zeros(0, np.float32), 10.5, 0.1),
            )
        )
    assert tuple(results[0]) == tuple(results[1])
    assert 0 < results[0][2] < len(scans)
