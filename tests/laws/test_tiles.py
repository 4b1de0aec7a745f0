"""Copy-on-write maps behave as if each particle had a map of its own, and count their tiles right."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from gridslam.errors import ArgumentError
from gridslam.grid import LOG_ODDS_UNIT, Evidence, TileMaps
from gridslam.types import LaserScan, ScanGeometry

CELL = 0.25  # a power of two: cells of the model are exact
ROWS = 3
EVIDENCE = Evidence(0.9, -0.4, -1.0, 2.0, 0.5)
SETTINGS = {"resolution_m": CELL, "reach_cells": 3.5, "evidence": EVIDENCE}


def beams_to(ends):
    """Beams from the base's origin that end exactly at `ends`, some of them of length 0."""
    ends = np.array(ends, dtype=np.float64).reshape(-1, 2)
    scan = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends))))
    return replace(scan.beams(0.0, np.inf), indices=np.arange(len(ends)), ends=ends)


def line(start, end):
    """Cells (y, x) from start to just before end, in whole numbers."""
    steps = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
    (y, dy), (x, dx) = ((a, b - a) for a, b in zip(start, end, strict=True))
    return [(y + (2 * i * dy + steps) // (2 * steps), x + (2 * i * dx + steps) // (2 * steps)) for i in range(steps)]


def insert(model, start, ends):
    """The binary Bayes filter on a map that is a dictionary from cells to steps of log-odds."""
    hit, miss, least, greatest, _ = EVIDENCE.steps
    for cell in [cell for end in ends for cell in line(start, end) if cell not in set(ends)]:
        model[cell] = max(model.get(cell, 0) + miss, least)
    for end in ends:
        model[end] = min(model.get(end, 0) + hit, greatest)


def as_model(maps, row):
    """Map `row` of tiled maps as such a dictionary."""
    grid = maps.occupancy(row)
    corner = np.rint(np.array(grid.origin[::-1]) / CELL).astype(int)
    cells = np.argwhere(grid.known)
    values = np.rint(grid.log_odds[grid.known] / LOG_ODDS_UNIT).astype(int)
    return {tuple(cell): value for cell, value in zip((cells + corner).tolist(), values.tolist(), strict=True)}


def assert_counts(owners):
    """The arena's counts equal those by brute force over the tables of all its owners, and no tile is lost."""
    arena = owners[0]._arena
    assert all(owner._arena is arena for owner in owners)
    page_uses = np.zeros(len(arena.page_refs), int)
    for owner in owners:
        for page in owner._roots.ravel():
            page_uses[page] += page > 0
    tile_uses = np.zeros(len(arena.tile_refs), int)
    for page in np.flatnonzero(page_uses):
        for tile in arena.pages[page].ravel():
            tile_uses[tile] += tile > 0
    np.testing.assert_array_equal(arena.page_refs, page_uses)
    np.testing.assert_array_equal(arena.tile_refs, tile_uses)
    for uses, free in ((page_uses, arena._free_pages), (tile_uses, arena._free_tiles)):
        assert sorted([*np.flatnonzero(uses), *free]) == list(range(1, len(uses)))
    assert arena.tiles_used == np.count_nonzero(tile_uses)
    assert not arena.pages[0].any()
    assert not arena.field[0].any()
    assert (arena.log_odds[0] == np.iinfo(arena.log_odds.dtype).min).all()


# Cells in reach of a beam cross borders of tiles (every 32 cells) and the corner of four pages at the origin.
cells = st.tuples(st.integers(-45, 45), st.integers(-45, 45))
scans = st.lists(cells, min_size=1, max_size=4)
some_rows = st.lists(st.integers(0, ROWS - 1), min_size=1, max_size=ROWS, unique=True)


class Maps(RuleBasedStateMachine):
    """Any sequence of operations on any number of owners of maps, beside dictionaries that copy everything."""

    @initialize()
    def begin(self):
        self.owners = [(TileMaps(ROWS, **SETTINGS), [{} for _ in range(ROWS)])]

    def _owner(self, which):
        return self.owners[which % len(self.owners)]

    @rule(which=st.integers(0, 9), rows=some_rows, start=cells, ends=scans, shift=cells)
    def update(self, which, rows, start, ends, shift):
        """Each row sees the scan from its own pose."""
        maps, models = self._owner(which)
        poses = np.zeros((len(rows), 3))
        for i, row in enumerate(rows):
            at = [a + i * b for a, b in zip(start, shift, strict=True)]
            poses[i, :2] = (np.array(at[::-1]) + 0.5) * CELL
            insert(models[row], tuple(at), [(at[0] + y, at[1] + x) for y, x in ends])
        maps.update(np.array(rows, np.int32), poses, beams_to([(x * CELL, y * CELL) for y, x in ends]))

    @rule(which=st.integers(0, 9), parents=st.lists(st.integers(0, ROWS - 1), min_size=ROWS, max_size=ROWS))
    def select(self, which, parents):
        maps, models = self._owner(which)
        maps.select(np.array(parents))
        models[:] = [dict(models[parent]) for parent in parents]

    @precondition(lambda self: len(self.owners) < 4)
    @rule(which=st.integers(0, 9))
    def snapshot(self, which):
        maps, models = self._owner(which)
        self.owners.append((maps.snapshot(), [dict(model) for model in models]))

    @rule(which=st.integers(0, 9), row=st.integers(0, ROWS - 1))
    def clear(self, which, row):
        maps, models = self._owner(which)
        maps.clear(row)
        models[row].clear()

    @rule(which=st.integers(0, 9))
    def compact(self, which):
        self._owner(which)[0].compact()

    @precondition(lambda self: len(self.owners) > 1)
    @rule(which=st.integers(0, 9))
    def delete(self, which):
        del self.owners[which % len(self.owners)]

    @rule(which=st.integers(0, 9))
    def write_and_read(self, which):
        """A restored owner replaces the old one; it lives in an arena of its own from then on."""
        maps, models = self._owner(which)
        arrays = maps.to_arrays()
        restored = TileMaps.from_arrays(arrays, **SETTINGS)
        again = restored.to_arrays()
        assert all(arrays[name].tobytes() == again[name].tobytes() for name in arrays)
        self.owners[which % len(self.owners)] = restored, models

    @invariant()
    def nothing_leaks(self):
        for maps, models in self.owners:
            for row, model in enumerate(models):
                assert as_model(maps, row) == model

    @invariant()
    def counts_are_right(self):
        arenas = {}
        for maps, _ in self.owners:
            arenas.setdefault(id(maps._arena), []).append(maps)
        for sharing in arenas.values():
            assert_counts(sharing)


TestMaps = Maps.TestCase
TestMaps.settings = settings(
    max_examples=60, stateful_step_count=20, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)


@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (-1, -1), (1, -1), (-1, 1)])
def test_maps_grow_in_every_direction(direction):
    """A drive of 40 scans, 25 cells apart, leaves the first page on every side and loses nothing."""
    maps, model = TileMaps(2, **SETTINGS), {}
    for i in range(40):
        at = tuple(25 * i * d for d in direction)
        ends = [(at[0] + y, at[1] + x) for y, x in ((0, 20), (20, 0), (-20, -3), (5, -20))]
        pose = [(at[1] + 0.5) * CELL, (at[0] + 0.5) * CELL, 0.0]
        beams = beams_to([((x - at[1]) * CELL, (y - at[0]) * CELL) for y, x in ends])
        maps.update(np.array([1], np.int32), np.array([pose]), beams)
        insert(model, at, ends)
    assert as_model(maps, 1) == model
    assert as_model(maps, 0) == {}
    assert_counts([maps])


def random_scan(rng, maps):
    poses = rng.normal(scale=[5.0, 5.0, 2.0], size=(len(maps), 3))
    maps.update(np.arange(len(maps), dtype=np.int32), poses, beams_to(rng.normal(scale=6.0, size=(20, 2))))


@pytest.mark.parametrize("seed", range(6))
def test_restored_maps_go_on_to_the_same_bytes(seed):
    """Also where the original still shares its tiles with a snapshot, which the restored maps know nothing of."""
    rng = np.random.default_rng(seed)
    maps = TileMaps(5, **SETTINGS)
    for _ in range(4):
        random_scan(rng, maps)
        maps.select(np.sort(rng.integers(0, 5, 5)))
    keep = maps.snapshot() if seed % 2 else None
    restored = TileMaps.from_arrays(maps.to_arrays(), **SETTINGS)
    for maps_again in (maps, restored):
        rng = np.random.default_rng(seed + 100)
        for _ in range(4):
            random_scan(rng, maps_again)
            maps_again.select(np.sort(rng.integers(0, 5, 5)))
        maps_again.clear(2)
        random_scan(rng, maps_again)
    one, other = maps.to_arrays(), restored.to_arrays()
    assert all(one[name].tobytes() == other[name].tobytes() for name in one)
    assert_counts([restored])
    assert_counts([maps] if keep is None else [maps, keep])


def test_the_empty_page_and_tile_come_first_even_where_every_entry_is_used():
    """One map whose only page is used: the table itself holds no 0."""
    maps = TileMaps(1, **SETTINGS)
    pose = np.array([[60.0, 60.0, 0.0]])  # with 12.5 m of beam well inside page (0, 0), which is 128 m wide
    maps.update(np.array([0], np.int32), pose, beams_to([(12.5, 0.0)]))
    arrays = maps.to_arrays()
    assert arrays["roots"].tolist() == [[[1]]]
    assert not arrays["pages"][0].any()
    assert (arrays["log_odds"][0] == -(2**15)).all()
    assert as_model(TileMaps.from_arrays(arrays, **SETTINGS), 0) == as_model(maps, 0)


def broken(arrays, name, change):
    array = arrays[name].copy()
    return {**arrays, name: change(array)}


def with_value(index, value):
    def change(array):
        array[index] = value
        return array

    return change


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("roots", with_value((0, 0, 0), 99)),
        ("roots", with_value((0, 0, 0), -1)),
        ("roots", lambda a: a * 0),
        ("roots", lambda a: a.astype(np.int64)),
        ("roots", lambda a: a[:0]),
        ("first", lambda a: a[:1]),
        ("first", lambda a: a * 0.5),
        ("pages", with_value((0, 0, 0), 1)),
        ("pages", with_value((1, 0, 0), 10**6)),
        ("pages", lambda a: a[:, :8]),
        ("log_odds", with_value((0, 3, 3), 0)),
        ("log_odds", lambda a: a.astype(np.float32)),
        ("field", with_value((0, 3, 3), 7)),
        ("field", lambda a: np.concatenate([a, a[:1]])),
    ],
)
def test_arrays_that_could_corrupt_memory_are_refused(name, change):
    maps = TileMaps(2, **SETTINGS)
    random_scan(np.random.default_rng(1), maps)
    with pytest.raises(ArgumentError, match=name):
        TileMaps.from_arrays(broken(maps.to_arrays(), name, change), **SETTINGS)
