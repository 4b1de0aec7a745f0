"""Maps far from the world's origin, far beams, many beams: the same cells, or a refusal that changes nothing."""

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gridslam
from gridslam.errors import ArgumentError
from gridslam.grid import Evidence, TileMaps
from gridslam.kernels import FARTHEST, MOST_BEAM_CELLS, PAGE, TILE
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import LaserScan, ScanGeometry
from support.same_map import assert_same_map

CELL = 0.0625  # a power of two: what is moved by whole cells is the same to the last bit
EVIDENCE = Evidence(2.4, -0.4, -16.0, 32.0, 2.0)
ROW = np.zeros(1, np.int32)
NO_PRIOR = np.zeros((1, 3, 3))
UTM = np.array([450_016.0, 5_411_008.0, 0.0])  # whole pages
FAR_M = FARTHEST * CELL


def new_maps(rows=1, **options):
    return TileMaps(rows, resolution_m=CELL, reach_cells=6.5, evidence=EVIDENCE, **options)


def beams_to(ends):
    ends = np.array(ends, np.float64).reshape(-1, 2)
    scan = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends))))
    return replace(scan.beams(0.0, np.inf), indices=np.arange(len(ends)), ends=ends, origin=np.zeros(2))


def room_from(seed, beams=50):
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(-math.pi, math.pi, beams))
    return beams_to(rng.uniform(3, 9, (beams, 1)) * np.column_stack([np.cos(angles), np.sin(angles)]))


def held(maps):
    return {name: array.copy() for name, array in maps.to_arrays().items()}


def assert_unchanged(maps, before):
    for name, array in maps.to_arrays().items():
        np.testing.assert_array_equal(array, before[name])


@settings(deadline=None, max_examples=25)
@given(
    st.tuples(*[st.integers(-FARTHEST // TILE + 40, FARTHEST // TILE - 40)] * 2),
    st.integers(0, 10**6),
    st.floats(-3, 3),
)
def test_a_map_moved_by_whole_tiles_is_the_same_map(tiles, seed, theta):
    """Written, matched and read the same way; matching to rounding, as world coordinates are larger."""
    shift = np.array([*tiles, 0.0]) * TILE * CELL
    poses = np.array([[0.0, 0.0, theta], [0.5, -0.25, theta + 0.125]])
    guess = np.array([[0.25, 0.0, theta + 0.0625]])
    found = []
    for at in (np.zeros(3), shift):
        maps = new_maps()
        for k, pose in enumerate(poses):
            maps.update(ROW, (pose + at)[None], room_from(seed + k))
        match = GaussNewton()(maps, ROW, guess + at, NO_PRIOR, room_from(seed))
        arrays = maps.to_arrays()
        found.append((arrays["log_odds"], arrays["field"], match.poses - at, match.score))
        assert maps.to_arrays()["roots"].size <= 4
    for here, there in zip(*(parts[:2] for parts in found), strict=True):
        assert sorted(tile.tobytes() for tile in here) == sorted(tile.tobytes() for tile in there)
    np.testing.assert_allclose(found[0][2], found[1][2], atol=1e-6)
    np.testing.assert_allclose(found[0][3], found[1][3], rtol=1e-4)


@pytest.mark.parametrize(
    "pose",
    [
        (FAR_M, 0, 0),
        (0, -FAR_M, 0),
        (1e9, 0, 0),
        (0, 1e300, 0),
        (math.nan, 0, 0),
        (0, math.inf, 0),
        (0, 0, math.nan),
        (0, 0, -math.inf),
    ],
)
def test_where_no_map_can_be_a_scan_is_refused_and_nothing_is_changed(pose):
    maps = new_maps(2)
    rows = np.arange(2, dtype=np.int32)
    maps.update(rows, np.zeros((2, 3)), room_from(2))
    before = held(maps)
    with pytest.raises(ArgumentError, match=r"poses: expected finite poses within 6.71e\+07 m"):
        maps.update(rows, np.array([(0, 0, 0), pose], np.float64), room_from(3))
    assert_unchanged(maps, before)
    maps.update(rows, np.zeros((2, 3)), room_from(3))


def test_maps_that_span_too_much_are_refused_before_tables_are_allocated():
    maps = new_maps()
    maps.update(ROW, UTM[None], room_from(4))
    before = held(maps)
    with pytest.raises(ArgumentError, match=r"span at most 2.1e\+09 cells, got 4\d{5} m x 5\d{6} m in cells"):
        maps.update(ROW, np.zeros((1, 3)), room_from(4))
    assert_unchanged(maps, before)


@pytest.mark.filterwarnings("ignore:ranges have a median")
@pytest.mark.parametrize("ends", [(1e300, 0), (math.nan, 1), (MOST_BEAM_CELLS * CELL + 1, 0)])
def test_beams_that_end_too_far_away_are_refused(ends):
    maps = new_maps()
    with pytest.raises(ArgumentError, match=r"beams: expected ends within 1312.5 m, 21000 cells, of the robot"):
        maps.update(ROW, np.zeros((1, 3)), beams_to([(1, 1), ends]))


def test_maps_never_take_more_tiles_than_they_may():
    maps = new_maps(3, most_tiles=400)
    rows = np.arange(3, dtype=np.int32)
    maps.update(rows, np.zeros((3, 3)), room_from(7))
    for step in range(1, 60):
        poses = np.array([[15.0 * step, 7.0 * k, 0.0] for k in range(3)])
        before = [maps.occupancy(row) for row in range(3)]
        try:
            maps.update(rows, poses, room_from(step))
        except ArgumentError as error:
            assert "at most 400 tiles" in str(error)  # noqa: PT017 the loop ends with it
            break
    else:
        pytest.fail("the maps grew on")
    for row, grid in enumerate(before):
        assert_same_map(maps.occupancy(row), grid)
    assert 300 < maps.tiles_used <= 400 + 3 * 60  # a ring about the ends of one scan
    maps.update(rows, np.zeros((3, 3)), room_from(8))  # what is mapped already costs nothing


@pytest.mark.parametrize("place", [1e9, -1e300, math.nan])
def test_a_state_with_poses_beyond_any_map_ends_no_process(place):
    """Far poses are refused at the next key scan; one of NaN is no key scan, and so never mapped."""
    rng = np.random.default_rng(9)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=60), rng)
    for name in ("poses", "key_pose"):
        slam = gridslam.GridFastSlam(particles=3, loop_closure=gridslam.build(gridslam.Configuration()).loop_closure)
        state = gridslam.run(log.measurements[:20], slam, rng=np.random.default_rng(1))
        setattr(state, name, np.full_like(state.poses, place) if name == "poses" else (place, place, place))
        error = gridslam.errors.GridslamError
        refused = contextlib.suppress(error) if math.isnan(place) else pytest.raises(error)
        with np.errstate(all="ignore"), refused:
            gridslam.run(log.measurements[20:60], slam, rng=rng, state=state)


def test_arrays_of_a_map_beyond_the_farthest_page_are_refused():
    maps = new_maps()
    maps.update(ROW, np.zeros((1, 3)), room_from(1))
    arrays = maps.to_arrays()
    for first in (FARTHEST // (PAGE * TILE), 2**40, -(2**62)):
        with pytest.raises(ArgumentError, match="first: expected a table within"):
            TileMaps.from_arrays(
                arrays | {"first": np.array([0, first])}, resolution_m=CELL, reach_cells=6.5, evidence=EVIDENCE
            )
