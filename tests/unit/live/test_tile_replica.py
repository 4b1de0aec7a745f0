"""Changes of a map, put together, give the map exactly: whatever is written, resampled, looked at or left out."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.grid.cells import Evidence
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import TILE, UNKNOWN
from gridslam.live.tiles import TILE_BYTES, TileChangeDetector, TileChanges, TileReplica, split_into_tiles
from gridslam.scan import StoredScan

SIDE_M = 0.05
FORM = {"resolution_m": SIDE_M, "reach_cells": 10.5, "evidence": Evidence(1.5, -0.4, -16.0, 32.0, 2.0)}


def write(maps, rng, centre, spread_m=0.3, reach_m=2.0):
    """Insert a scan into every map."""
    poses = np.column_stack([centre + rng.normal(0, spread_m, (len(maps), 2)), rng.uniform(-3, 3, len(maps))])
    ends = rng.uniform(-1, 1, (20, 2)) * reach_m / np.sqrt(2)
    maps.update(np.arange(len(maps), dtype=np.int32), poses, StoredScan(ends, np.zeros(2)))


DOING = st.lists(st.sampled_from(["write", "write", "select", "look", "look", "other"]), min_size=5, max_size=40)


@settings(max_examples=60, deadline=None)
@given(DOING, st.integers(0, 2**32 - 1))
def test_changes_give_the_map_exactly(doing, seed):
    rng = np.random.default_rng(seed)
    maps, detector, replica, row = TileMaps(5, **FORM), TileChangeDetector(), TileReplica(), 0
    where = np.zeros(2)
    for what in [*doing, "look"]:
        if what == "write":
            where = where + rng.uniform(-4, 4, 2)
            write(maps, rng, where)
        elif what == "select":
            maps.select(np.sort(rng.integers(0, 5, 5)))
        elif what == "other":
            row = int(rng.integers(5))
        else:
            replica.apply(detector.find_changes(maps, row))
            expected = TileReplica()
            expected.apply(split_into_tiles(maps.occupancy(row)))
            assert looks_of(replica) == looks_of(expected)


def looks_of(replica):
    """The tiles in which something is seen."""
    at, looks, _ = replica.since(0, 10**6)
    return {tuple(one): look.tobytes() for one, look in zip(at.tolist(), looks, strict=True) if look.any()}


@given(st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_any_number_of_viewers_gets_all_in_pieces_of_any_size(most, seed):
    """Two viewers who look at other times; in between tiles change again."""
    rng, replica = np.random.default_rng(seed), TileReplica()
    seen = [({}, 0), ({}, 0)]
    for _ in range(6):
        at = np.unique(rng.integers(-3, 3, (4, 2)), axis=0).astype(np.int32)
        replica.apply(TileChanges(at, rng.choice([UNKNOWN, -300, 0, 300], (len(at), TILE, TILE)).astype(np.int16)))
        for k in np.flatnonzero(rng.integers(0, 2, 2)):
            tiles, number = seen[k]
            where, looks, number = replica.since(number, most)
            assert len(where) <= most
            tiles.update(zip(map(tuple, where.tolist()), looks, strict=True))
            seen[k] = tiles, number
    for tiles, number in seen:
        while number < replica.sequence:
            where, looks, number = replica.since(number, most)
            tiles.update(zip(map(tuple, where.tolist()), looks, strict=True))
        where, looks, _ = replica.since(0, 10**6)
        assert {at: look.tobytes() for at, look in tiles.items()} == {
            tuple(at): look.tobytes() for at, look in zip(where.tolist(), looks, strict=True)
        }


def test_a_new_map_replaces_the_old_one():
    replica = TileReplica()
    replica.apply(TileChanges(np.array([[0, 0], [5, 5]], np.int32), np.full((2, TILE, TILE), 200, np.int16)))
    replica.replace(dict.fromkeys([(5, 5), (6, 5)], bytes([17]) * TILE_BYTES))
    assert looks_of(replica).keys() == {(5, 5), (6, 5)}
