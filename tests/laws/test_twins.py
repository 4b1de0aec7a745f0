"""Every compiled kernel agrees with its NumPy twin: the integer ones to the last bit, the others to rounding."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

import gridslam.grid.tiles as tiles_module
import gridslam.kernels as kernels_module
from gridslam.grid import Evidence, TileMaps
from gridslam.kernels import reference, reference_update
from gridslam.types import LaserScan, ScanGeometry

compiled = pytest.importorskip("gridslam.kernels._compiled")

KERNELS = (
    "tiles_on_rays",
    "make_tiles_writable",
    "update",
    "match",
    "match_pose",
    "distances",
    "cast_rays",
    "known_cells",
    "max_pyramid",
    "correlate",
    "sum_at_ends",
    "fit_surfaces",
    "match_surfaces",
    "match_to_surfaces",
)
"""Those from `max_pyramid` on in the tests of branch and bound and of surfaces."""
SEEDS = range(10)
CELL = 0.05
SINGLE = 4e-4
"""Cells by which single precision may move the end of a beam.

Ends are at most 512 cells away along each axis, 724 in all: a coordinate is the sum of two products, each of an end
rounded at 2^-24 * 512 = 3e-5 with a sine rounded at 2^-24, so six such roundings at the very most. The distance changes
by at most a cell per cell along each axis.
"""
ROWS = np.arange(3, dtype=np.int32)
ORIGIN = np.array([0.11, -0.07])
EVIDENCES = (
    Evidence(2.4, -0.4, -16, 32, 2.0),
    Evidence(0.06, -0.05, -0.1, 0.13, 0.05),  # clamps are met within three scans
    Evidence(1.0, -1.0, -2.0, 2.0, 0.0),
    Evidence(2.4, -0.37, -1.6, 3.2, 2.0),  # more than a byte holds
)


def random_ends(rng, beams=60):
    """Ends in all directions; some on borders of cells, tiles and pages, at the laser, twice, or along an axis."""
    ends = rng.uniform(-1, 1, (beams, 2)) * rng.choice([0.2, 3.0, 20.0], (beams, 1))
    kind = rng.integers(0, 8, beams)
    side = CELL * rng.choice([1, 32, 512], (beams, 1))
    ends[kind == 0] = (np.round(ends / side) * side)[kind == 0]
    ends[kind == 1] = ORIGIN
    ends[kind == 2] = ends[rng.integers(0, beams, np.count_nonzero(kind == 2))]
    ends[kind == 3, 0] = ORIGIN[0]
    ends[kind == 4, 1] = ORIGIN[1]
    return ends


def random_poses(rng, count=3):
    """Poses around the world's origin, where four pages meet, and at other pages' corners, some exactly on borders."""
    poses = rng.normal(scale=[1.0, 1.0, 2.0], size=(count, 3))
    poses[:, :2] += 512 * CELL * rng.integers(-1, 2, (count, 2))
    on_border = rng.random(count) < 0.3
    poses[on_border, :2] = np.round(poses[on_border, :2] / (32 * CELL)) * (32 * CELL)
    straight = rng.random(count) < 0.3
    poses[straight, 2] = np.pi / 2 * rng.integers(-2, 3, np.count_nonzero(straight))
    return poses


def beams_to(ends, origin=ORIGIN):
    """Beams that end exactly at `ends` (B, 2), some of them of length 0."""
    scan = LaserScan.from_ranges(0, np.hypot(*(ends - origin).T), ScanGeometry(np.zeros(len(ends))))
    return replace(scan.beams(0.0, np.inf), indices=np.arange(len(ends)), ends=ends, origin=origin)


def random_maps(rng, scans=4):
    """Three maps that share some tiles, with unknown, free and occupied cells, and cells that became free again."""
    evidence = EVIDENCES[rng.integers(len(EVIDENCES))]
    maps = TileMaps(3, resolution_m=CELL, reach_cells=rng.choice([1.0, 3.7, 10.5, 15.5]), evidence=evidence)
    for _ in range(scans):
        beams = beams_to(random_ends(rng))
        poses = random_poses(rng)
        maps.update(ROWS, poses, beams)
        maps.update(ROWS[:1], poses[:1] + np.array([0.03, 0.02, 0.01]), beams)
        maps.select(np.sort(rng.integers(0, 3, 3)))
    return maps


def copies(view):
    """A copy of the five arguments that describe maps."""
    return tuple(part.copy() if isinstance(part, np.ndarray) else part for part in view)


def as_set(table):
    """The rows of a table, each of which must be there once."""
    rows = set(map(tuple, table.tolist()))
    assert len(rows) == len(table)
    return rows


def assert_same_maps(one, other):
    for name, a, b in zip(("roots", "first", "pages", "log_odds", "field"), one, other, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


def test_both_offer_the_same_functions():
    assert all(callable(getattr(compiled, name)) and callable(getattr(reference, name)) for name in KERNELS)
    assert set(reference.__all__) == set(KERNELS)
    assert {name for name in dir(compiled) if not name.startswith("_")} == set(KERNELS)


@pytest.mark.parametrize("seed", SEEDS)
def test_touched_tiles(seed):
    rng = np.random.default_rng(seed)
    poses, ends = random_poses(rng), random_ends(rng)
    by_rays = [k.tiles_on_rays(ROWS, poses, ends, ORIGIN, CELL, 2) for k in (compiled, reference)]
    assert as_set(by_rays[0]) == as_set(by_rays[1])
    assert len(by_rays[0]) > 3


def test_nothing_is_touched_without_poses():
    for kernels in (compiled, reference):
        none = kernels.tiles_on_rays(ROWS[:0], np.zeros((0, 3)), np.ones((4, 2)), ORIGIN, CELL, 1)
        assert none.shape == (0, 3)


def reserve(arena, count):
    """Have `count` free pages and tiles at least."""
    while min(map(len, arena.free_ids)) < count:
        pages, tiles = arena.free_ids
        arena._free_pages = arena._free_tiles = np.zeros(0, np.int32)
        arena.grow()
        arena._free_pages = np.concatenate([arena._free_pages, pages])
        arena._free_tiles = np.concatenate([arena._free_tiles, tiles])


@pytest.mark.parametrize("few", [3, 1000])
@pytest.mark.parametrize("seed", SEEDS)
def test_owned_tiles(seed, few):
    """As far as the free ids go: three are too few for any scan."""
    rng = np.random.default_rng(seed)
    maps = random_maps(rng)
    poses, ends = random_poses(rng), random_ends(rng)
    keep = maps.snapshot()
    maps._cover(poses, beams_to(ends))
    touched = compiled.tiles_on_rays(ROWS, poses, ends, ORIGIN, CELL, 1)
    reserve(maps._arena, 64)
    pages, tiles = maps._arena.free_ids
    results = []
    for kernels in (compiled, reference):
        view, refs = copies(maps._view), (maps._arena.page_refs.copy(), maps._arena.tile_refs.copy())
        results.append((view, refs, kernels.make_tiles_writable(*view, *refs, pages, tiles[-few:], touched)))
    assert_same_maps(results[0][0], results[1][0])
    np.testing.assert_array_equal(results[0][1][0], results[1][1][0])
    np.testing.assert_array_equal(results[0][1][1], results[1][1][1])
    assert tuple(results[0][2]) == results[1][2]
    assert 0 < results[1][2][1] <= few
    assert few > 3 or results[1][2][2] < len(touched)
    del keep


NOTHING = np.zeros((0, 4), np.int32)


def arguments_of_update(maps, poses, ends, *, pending=NOTHING, room=-1, threads=1):
    """Arguments of the kernel but for the maps: free ids are all that are left."""
    arena = maps._arena
    ids = arena.page_refs, arena.tile_refs, *arena.free_ids
    scan = ROWS[: len(poses)], poses, ends, ORIGIN, CELL, *maps._steps
    return (*ids, pending, room, *scan, maps._cone, 2 * maps.reach_m, threads)


def with_numbers_in_order(view):
    """Maps as plain arrays whatever their tiles' ids are."""
    roots, _, pages, log_odds, field = view
    tiles = pages[roots]
    own = tiles[tiles > 0]
    return (roots > 0, tiles > 0, log_odds[0], field[0], log_odds[own], field[own])


@pytest.mark.parametrize("seed", SEEDS)
def test_updates(seed):
    """The maps are the same, and as many ids are taken; each tile's number is its kernel's own."""
    rng = np.random.default_rng(seed)
    maps = random_maps(rng)
    for poses, ends in ((random_poses(rng), random_ends(rng)) for _ in range(3)):
        keep = maps.snapshot()
        maps._cover(poses, beams_to(ends))
        reserve(maps._arena, 4000)
        found = []
        for update, threads in [(reference.update, 1), (compiled.update, 1), (compiled.update, 2)]:
            view, arguments = copies(maps._view), copies(arguments_of_update(maps, poses, ends, threads=threads))
            status, pages, tiles, left, pending = update(*view, *arguments)
            assert (status, left.shape, pending.shape) == (0, (0,), (0, 4))
            assert not view[4][0].any()
            found.append((*with_numbers_in_order(view), np.bincount(arguments[1]), [pages, tiles]))
        for own in found[1:]:
            for one, other in zip(found[0], own, strict=True):
                np.testing.assert_array_equal(one, other)
        maps.update(ROWS, poses, beams_to(ends))
        del keep


@pytest.mark.parametrize("seed", range(2))
def test_updates_where_ids_are_scarce(seed, monkeypatch):
    """Whichever tile the ids suffice to: the maps are those of an arena in which there are enough."""
    rng = np.random.default_rng(seed)
    scans = [(random_poses(rng), beams_to(random_ends(rng))) for _ in range(4)]
    evidence = EVIDENCES[seed % len(EVIDENCES)]
    made, stops = [], set()
    for kernels, scarce in ((compiled, True), (reference, True), (compiled, False)):

        def update(*arguments, kernels=kernels):
            found = kernels.update(*arguments)
            stops.add((found[0] == 0, len(found[4]) > 0))
            return found

        monkeypatch.undo()
        monkeypatch.setattr(tiles_module, "backend", SimpleNamespace(update=update))
        maps = TileMaps(3, resolution_m=CELL, reach_cells=10.5, evidence=evidence)
        if scarce:
            step = int(rng.integers(1, 4))
            monkeypatch.setattr(type(maps._arena), "_extend_ids", staticmethod(partial(a_few_ids, step)))
        for poses, beams in scans:
            maps.update(ROWS, poses, beams)
            maps.select(np.array([0, 0, 2]))
        made.append(maps.to_arrays())
    for name in made[0]:
        np.testing.assert_array_equal(made[0][name], made[2][name])
        np.testing.assert_array_equal(made[1][name], made[2][name])
    assert (True, True) in stops  # a field was left to follow


def a_few_ids(step, refs):
    """Ids of `step` more tiles or pages than `refs` counts."""
    return np.arange(len(refs) + step - 1, len(refs) - 1, -1, dtype=np.int32), len(refs) + step


def test_what_the_tables_do_not_hold_is_not_written():
    maps = random_maps(np.random.default_rng(0))
    ends = np.array([[3.0, 0.0]])
    for pose in ([1e6, 0, 0], [0, -1e6, 0], [np.nan, 0, 0], [0, np.inf, 0], [0, 0, np.nan]):
        for far in (ends, ends + 2000.0, ends * np.nan):
            for kernels in (compiled, reference):
                view, arguments = copies(maps._view), copies(arguments_of_update(maps, np.array([pose]), far))
                assert kernels.update(*view, *arguments)[:3] == (kernels_module.OUTSIDE, 0, 0)
                assert_same_maps(view, maps._view)


def test_no_more_tiles_are_crossed_than_there_is_room_for():
    maps = random_maps(np.random.default_rng(0))
    poses, ends = np.zeros((3, 3)), np.array([[3.0, 0.0], [0.0, -4.0]])
    maps._cover(poses, beams_to(ends))
    crossed = len(reference.tiles_on_rays(ROWS, poses, ends, ORIGIN, CELL, 1))
    for kernels in (compiled, reference):
        view, arguments = copies(maps._view), copies(arguments_of_update(maps, poses, ends, room=crossed - 1))
        assert kernels.update(*view, *arguments)[:3] == (kernels_module.NO_ROOM, 0, 0)
        assert_same_maps(view, maps._view)
        arguments = copies(arguments_of_update(maps, poses, ends, room=crossed))
        assert kernels.update(*view, *arguments)[0] == 0


def test_updates_meet_every_case():
    """The seeds above are no proof unless cells become occupied, become free, and meet both clamps."""
    kinds, least, greatest = set(), set(), set()
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        maps = random_maps(rng)
        poses, ends = random_poses(rng), random_ends(rng)
        maps._cover(poses, beams_to(ends))
        maps._make_writable(reference.tiles_on_rays(ROWS, poses, ends, ORIGIN, CELL, 1))
        steps = maps._steps
        changed = reference_update.update_log_odds(*maps._view, ROWS, poses, ends, ORIGIN, CELL, *steps, 1)
        kinds |= set(changed[:, 3].tolist())
        least.add(bool((maps._arena.log_odds == steps[2]).any()))
        greatest.add(bool((maps._arena.log_odds == steps[3]).any()))
    assert kinds == {0, 1}
    assert True in least
    assert True in greatest


@pytest.mark.parametrize("seed", SEEDS)
def test_distances_and_ray_casting(seed):
    rng = np.random.default_rng(seed)
    maps = random_maps(rng)
    poses, points = random_poses(rng, 5), random_ends(rng)
    rows = rng.integers(0, 3, 5).astype(np.int32)
    bearings = np.concatenate([rng.uniform(-np.pi, np.pi, 40), np.pi / 4 * np.arange(8)])
    directions = np.column_stack([np.cos(bearings), np.sin(bearings)])
    directions[-3:] = [[1, 0], [0, -1], [0, 0]]
    far = (rows, poses, points, CELL, maps.reach_cells, 2)
    ray = (rows, poses, ORIGIN, directions, CELL, 12.0, 2)
    np.testing.assert_allclose(
        compiled.distances(*maps._view, *far), reference.distances(*maps._view, *far), rtol=0, atol=SINGLE * CELL
    )
    for row, pose in zip(rows.tolist(), poses, strict=True):
        known = [k.known_cells(*maps._view, row, pose, points, CELL) for k in (compiled, reference)]
        np.testing.assert_array_equal(*known)
    ranges = compiled.cast_rays(*maps._view, *ray)
    np.testing.assert_allclose(ranges, reference.cast_rays(*maps._view, *ray), rtol=0, atol=2e-6)
    assert (ranges >= 0).all()
    assert (ranges[:, -1] >= np.float32(12.0)).sum() + (ranges[:, -1] == 0).sum() == len(rows)


def settings_of(maps, passes, least, lines):
    return passes, 1, 2.0, 2.0, 0.1, 0.02, 2e-4, maps.reach_cells, least, lines, 2


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("passes", [1, 2])
@pytest.mark.parametrize("lines", [False, True])
def test_steps_of_a_match(seed, passes, lines):
    """Anywhere, even where there is nothing to match, a step is that of the twin as far as single precision reaches."""
    rng = np.random.default_rng(seed)
    maps = random_maps(rng)
    truth, ends = random_poses(rng), random_ends(rng)
    maps.update(ROWS, truth, beams_to(ends))
    guesses = truth + rng.normal(scale=[0.05, 0.05, 0.01], size=truth.shape)
    guesses[0] += [500.0, 0.0, 0.0]  # nothing is there: the prior alone
    priors = np.repeat(np.diag([0.1, 0.2, 0.1])[None], 3, axis=0)  # the steps are well conditioned by it
    settings = settings_of(maps, passes, float(rng.choice([0.0, 0.02, 0.3])), lines)
    one, other = (k.match(*maps._view, ROWS, guesses, priors, ends, CELL, *settings) for k in (compiled, reference))
    np.testing.assert_allclose(one[0][0], guesses[0] - [0, 0, 2 * np.pi * np.floor(guesses[0, 2] / 2 / np.pi + 0.5)])
    np.testing.assert_allclose(one[0], other[0], rtol=0, atol=SINGLE * CELL)
    # A residual in [0, 15.5] cells moves by SINGLE, a weight by at most that over 2 c = 4 cells, for 60 beams
    np.testing.assert_allclose(one[2], other[2], rtol=0, atol=60 * SINGLE / 4)
    greatest = np.abs(other[1]).max(axis=(1, 2), keepdims=True)
    # An end that crosses the border of four cells takes another gradient: one of 60 beams, rarely
    np.testing.assert_allclose(one[1] / (1 + greatest), other[1] / (1 + greatest), rtol=0, atol=2e-3)


def scan_of_box(half, truth, beams=180):
    """Ends of beams, in all directions, on the walls |x| = half[0] and |y| = half[1]; seen from `truth` (3,)."""
    bearings = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    directions = np.column_stack([np.cos(bearings + truth[2]), np.sin(bearings + truth[2])])
    with np.errstate(divide="ignore"):
        ranges = ((half * np.sign(directions) - truth[:2]) / directions).min(axis=1)
    return ranges[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])


def scans_matched(maps, truth, ends, rng, lines):
    """What either twin makes of it, from guesses up to 10 cm and 2 degrees away, with a prior and without."""
    guesses = truth + rng.uniform(-1, 1, (3, 3)) * [0.1, 0.1, 0.035]
    priors = np.array([0.0, 0.0025, 0.25])[:, None, None] * np.eye(3)
    settings = settings_of(maps, 10, 0.02, lines)
    return (k.match(*maps._view, ROWS, guesses, priors, ends, CELL, *settings) for k in (compiled, reference))


@pytest.mark.parametrize("seed", SEEDS)
def test_matches_in_a_room(seed):
    """Where there is a minimum both find it."""
    rng = np.random.default_rng(seed)
    half = rng.uniform(2, 8, 2)
    truth = np.concatenate([rng.uniform(-0.5, 0.5, 2) * half, rng.uniform(-np.pi, np.pi, 1)])
    ends = scan_of_box(half, truth)
    maps = TileMaps(3, resolution_m=CELL, reach_cells=10.5, evidence=EVIDENCES[0])
    maps.update(ROWS, np.repeat(truth[None], 3, axis=0), beams_to(ends, np.zeros(2)))
    one, other = scans_matched(maps, truth, ends, rng, False)
    # Both stop when a step is below 0.02 cells; where one takes one pass more they differ by a part of that
    np.testing.assert_allclose(one[0], other[0], rtol=0, atol=0.01 * CELL)
    np.testing.assert_allclose(one[0][:, :2], np.repeat(truth[None, :2], 3, axis=0), rtol=0, atol=0.5 * CELL)
    np.testing.assert_allclose(one[2], other[2], rtol=1e-3)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("lines", [False, True])
def test_matches_in_a_corridor(seed, lines):
    """Of a corridor with pillars and noise, where many ends lie on its straight walls, and others on nothing straight.

    The evaluated information shows which ends count across their wall only; it is that of one and the same pose.
    """
    rng = np.random.default_rng(seed)
    truth = np.concatenate([rng.uniform(-0.5, 0.5, 2), rng.uniform(-np.pi, np.pi, 1)])
    ends = scan_of_box(np.array([12.0, 1.1]), truth, int(rng.choice([60, 180, 181])))
    ends += rng.normal(scale=0.01, size=ends.shape)
    ends[rng.random(len(ends)) < 0.1] *= 0.7
    maps = TileMaps(3, resolution_m=CELL, reach_cells=10.5, evidence=EVIDENCES[0])
    maps.update(ROWS, np.repeat(truth[None], 3, axis=0), beams_to(ends, np.zeros(2)))
    there = (ROWS, truth + np.zeros((3, 1)), np.zeros((3, 3, 3)), ends, CELL)
    one, other = (k.match(*maps._view, *there, *settings_of(maps, 0, 0.0, lines)) for k in (compiled, reference))
    # One wall found by one of them alone would tell: an end's gradient along it is up to a cell a cell
    np.testing.assert_allclose(one[1], other[1], rtol=2e-3, atol=2e-3)
    one, other = scans_matched(maps, truth, ends, rng, lines)
    np.testing.assert_allclose(one[0], other[0], rtol=0, atol=0.01 * CELL)


def test_scans_of_corridors_have_straight_walls():
    """Else the test above would prove nothing."""
    truth = np.array([0.3, -0.2, 1.0])
    ends = scan_of_box(np.array([12.0, 1.1]), truth)
    maps = TileMaps(1, resolution_m=CELL, reach_cells=10.5, evidence=EVIDENCES[0])
    maps.update(ROWS[:1], truth[None], beams_to(ends, np.zeros(2)))
    along = [
        k.match(*maps._view, ROWS[:1], truth[None], np.zeros((1, 3, 3)), ends, CELL, *settings_of(maps, 0, 0.0, lines))[
            1
        ]
        for k in (compiled, reference)
        for lines in (False, True)
    ]
    assert along[1][0, 0, 0] < 0.7 * along[0][0, 0, 0]
    assert along[3][0, 0, 0] < 0.7 * along[2][0, 0, 0]


def test_matches_without_beams_stay_at_the_guess():
    maps = random_maps(np.random.default_rng(0))
    guess = np.array([[1.0, -2.0, 3.0]])
    for prior in (np.zeros((1, 3, 3)), np.eye(3)[None]):
        for kernels in (compiled, reference):
            poses, information, score = kernels.match(
                *maps._view, ROWS[:1], guess, prior, np.zeros((0, 2)), CELL, *settings_of(maps, 10, 0.02, True)
            )
            np.testing.assert_allclose(poses, guess, atol=1e-15)
            assert not information.any()
            assert not score.any()


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("passes", [0, 2, 10])
@pytest.mark.parametrize("thin_m", [0.0, 0.5])
def test_one_pose_is_matched_as_many_are(seed, passes, thin_m):
    """Thinned, as the ends that are left are; all ends are scored at the pose found."""
    rng = np.random.default_rng(seed)
    maps = random_maps(rng)
    truth, ends = random_poses(rng), random_ends(rng)
    maps.update(ROWS, truth, beams_to(ends))
    prior = (0.1, 0.01, -0.02, 0.2, 0.03, 0.3)
    xx, xy, xt, yy, yt, tt = prior
    whole = np.array([[[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]]])
    *settings, threads = settings_of(maps, passes, 0.02, True)
    kept = ends
    if thin_m:
        squares = np.floor(ends / thin_m)
        kept = ends[[j == 0 or not np.array_equal(squares[j], squares[j - 1]) for j in range(len(ends))]]
        assert 10 < len(kept) < len(ends)
    for kernels in (compiled, reference):
        for row, pose in enumerate(truth.tolist()):
            guess = np.array([pose])
            view = *maps._view, ROWS[row : row + 1]
            many = kernels.match(*view, guess, whole, kept, CELL, *settings, threads)
            numbers = kernels.match_pose(*maps._view, row, tuple(pose), prior, ends, thin_m, CELL, *settings)
            pose, information, score, agreeing = numbers
            np.testing.assert_array_equal(pose, many[0][0])
            np.testing.assert_array_equal(information, many[1][0][np.triu_indices(3)])
            assert score == many[2][0]
            if thin_m:
                all_ends = kernels.match(*view, many[0], whole, ends, CELL, *settings_of(maps, 0, 0.02, True))
                assert agreeing == all_ends[2][0]
            else:
                assert agreeing == score


@pytest.mark.parametrize("seed", range(5))
def test_whole_maps_grow_alike(seed, monkeypatch):
    """The same scans, selections and snapshots through either backend end in the same bytes."""
    states = []
    for kernels in (compiled, reference):
        monkeypatch.setattr(tiles_module, "backend", kernels)
        rng = np.random.default_rng(seed)
        maps = random_maps(rng)
        twin = maps.snapshot()
        twin.update(ROWS[1:], random_poses(rng, 2), beams_to(random_ends(rng)))
        states.append((maps.to_arrays(), twin.to_arrays()))
    for one, other in zip(*states, strict=True):
        assert one.keys() == other.keys()
        assert all(one[name].tobytes() == other[name].tobytes() for name in one)
