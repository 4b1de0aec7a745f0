"""Counts of beams: against every ray drawn by itself, whatever the scans' order."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.evaluation import interpolate
from gridslam.geometry.se2 import compose, exp, inverse, transform_points
from gridslam.grid import cell_centres
from gridslam.kernels.reference_update import ray_cells
from gridslam.mapping import OccupancyGridMapping
from gridslam.mapping.beam_counts import BeamCounts, bayes_map, counting_map
from gridslam.mapping.known_poses import KnownPoses, NoPoseReason
from gridslam.models import InverseSensorModel
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, simulate
from gridslam.sim.floor_plan import box, clearance, join
from gridslam.types import LaserScan, OccupancyGrid, ScanGeometry, StoredScan, Trajectory
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


ROUTE = [(1.02, 1.02), (5.02, 1.02), (5.02, 3.02), (1.02, 3.02)]
CRATE = (2.52, 1.77, 3.52, 2.27)


@pytest.fixture(scope="module")
def log():
    """A closed room of 6 m x 4 m with a crate in its middle, seen by a lidar that looks all around."""
    world = World.of("room", join(box(0.02, 0.02, 6.02, 4.02), box(*CRATE)), ROUTE)
    lidar = LidarConfig(beams=360, field_of_view_rad=2 * np.pi, rate_hz=2.0)
    return simulate(world, RobotConfig(), OdometryNoise(), lidar, np.random.default_rng(0))


def mapped(log, mapper):
    maps = mapper.empty(1)
    for pose, (_, scan) in zip(log.truth.poses, log.measurements, strict=True):
        mapper(maps, pose[None], scan.beams(0.05, 30.0))
    return maps


def centres(grid: OccupancyGrid):
    """World coordinates (H, W, 2) of a grid's cells."""
    rows, columns = grid.known.shape
    return np.array(grid.origin) + cell_centres(np.stack(np.mgrid[:rows, :columns], axis=-1), grid.resolution_m)


@pytest.mark.parametrize("resolution_m", [0.05, 0.1])
def test_a_room_becomes_its_map(log, resolution_m):
    """Occupied cells lie within 1 1/2 cells of a wall, and walls have some all along; farther inside all is free."""
    grid = mapped(log, OccupancyGridMapping(resolution_m=resolution_m)).occupancy(0)
    places = centres(grid)
    x, y = places[..., 0], places[..., 1]
    away = clearance(log.walls, places.reshape(-1, 2)).reshape(x.shape)
    occupied, free = grid.known & (grid.log_odds > 0), grid.known & (grid.log_odds < 0)
    assert away[occupied].max() < 1.5 * resolution_m + 0.03  # the lidar's noise is 1 cm
    room = (x > 0.02) & (x < 6.02) & (y > 0.02) & (y < 4.02)
    crate = (x > CRATE[0]) & (x < CRATE[2]) & (y > CRATE[1]) & (y < CRATE[3])
    far = away > 2 * resolution_m
    assert free[room & ~crate & far].all()
    assert not grid.known[~room & far].any()
    assert not grid.known[crate & far].any()
    on_walls = np.concatenate([np.linspace(wall[:2], wall[2:], 50)[1:-1] for wall in log.walls])
    nearest = np.sqrt(((on_walls[:, None] - places[occupied]) ** 2).sum(axis=2)).min(axis=1)
    assert (nearest < 1.5 * resolution_m).mean() > 0.98


def test_every_map_gets_the_scan_at_its_own_pose(log):
    """Two particles a metre apart: the same map, a metre apart (20 cells of 5 cm)."""
    mapper, (_, scan) = OccupancyGridMapping(), log.measurements[0]
    maps = mapper.empty(2)
    mapper(maps, np.array([[0.01, 0.01, 0.3], [1.01, 0.01, 0.3]]), scan.beams(0.05, 30.0))
    first, second = maps.occupancy(0), maps.occupancy(1)
    ours, theirs = (np.sort(centres(g)[g.known], axis=0) for g in (first, second))
    np.testing.assert_allclose(ours + np.array([1.0, 0.0]), theirs, atol=1e-6)


def test_the_evidence_is_the_sensors(log):
    """One scan: end cells hold at least one hit, all others whole numbers of misses; in steps of 0.01 nats."""
    mapper = OccupancyGridMapping(inverse_sensor=InverseSensorModel.from_log_odds(1.5, -0.25))
    maps = mapper.empty(1)
    mapper(maps, np.zeros((1, 3)), log.measurements[0].scan.beams(0.05, 30.0))
    grid = maps.occupancy(0)
    told = grid.log_odds[grid.known].astype(np.float64)
    hits, misses = told[told > 0], told[told < 0]
    np.testing.assert_allclose(hits / 1.5, np.rint(hits / 1.5), atol=1e-5)
    np.testing.assert_allclose(misses / 0.25, np.rint(misses / 0.25), atol=1e-5)
    assert hits.min() == pytest.approx(1.5)
    assert misses.max() == pytest.approx(-0.25)


def test_maps_are_restored_in_the_same_form(log):
    mapper = OccupancyGridMapping(resolution_m=0.1, reach_cells=6.0)
    maps = mapped(log, mapper)
    again = mapper.restore(maps.to_arrays(), threads=2)
    assert (again.resolution_m, again.reach_cells, again.threads) == (0.1, 6.0, 2)
    for ours, theirs in zip(maps.to_arrays().values(), again.to_arrays().values(), strict=True):
        np.testing.assert_array_equal(ours, theirs)


S = 1_000_000_000


def way(*rows) -> Trajectory:
    """Rows of stamp in s, x, y, theta."""
    table = np.array(rows, float)
    return Trajectory(np.rint(table[:, 0] * S).astype(np.int64), table[:, 1:])


def test_poses_between_are_linear_and_turn_the_shorter_way():
    known = KnownPoses(way((10, 0, 0, 3.0), (11, 2, -1, -3.0)))
    np.testing.assert_allclose(known.at(10 * S + S // 4), [0.5, -0.25, 3.0 + (2 * np.pi - 6) / 4])
    np.testing.assert_allclose(known.at(10 * S + 3 * S // 4), [1.5, -0.75, -3.0 - (2 * np.pi - 6) / 4])


@given(st.lists(st.integers(0, 3 * S), min_size=2, max_size=9, unique=True), st.integers(0, 2**32 - 1))
def test_they_are_those_that_evaluation_takes(stamps, seed):
    rng = np.random.default_rng(seed)
    trajectory = Trajectory(np.array(stamps, np.int64), rng.uniform(-3, 3, (len(stamps), 3)))
    asked = rng.integers(min(stamps), max(stamps) + 1, 5)
    known = KnownPoses(trajectory, max_gap_s=10.0)
    for stamp, expected in zip(asked.tolist(), interpolate(trajectory, asked, tolerance_ns=0)[0], strict=True):
        np.testing.assert_allclose(known.at(stamp), expected, atol=1e-12)


def test_nothing_is_extrapolated():
    known = KnownPoses(way((10, 0, 0, 0), (10.5, 1, 0, 0)))
    assert known.at(9 * S) is NoPoseReason.OUTSIDE
    assert known.at(10 * S - 1_000_001) is NoPoseReason.OUTSIDE
    assert known.at(round(10.5 * S) + 1_000_001) is NoPoseReason.OUTSIDE
    assert known.span_ns == (10 * S, round(10.5 * S))


def test_gaps_are_not_bridged():
    trajectory = way((0, 0, 0, 0), (1, 1, 0, 0), (3, 5, 0, 0))
    assert KnownPoses(trajectory).at(2 * S) is NoPoseReason.GAP
    np.testing.assert_allclose(KnownPoses(trajectory).at(S + 500_000), [1.001, 0, 0])  # 0.5 ms past a pose
    np.testing.assert_allclose(KnownPoses(trajectory, max_gap_s=2.0).at(2 * S), [3, 0, 0])


def test_a_scan_in_motion_is_sharpened():
    """A robot on an arc sees one wall point by each beam at the beam's own time: at the stamp they lie where they are.

    Between poses 2 ms apart the arc is a line but for r (omega dt)^2 / 8 < 1e-6 m.
    """
    twist, seconds = np.array([0.8, 0.0, 1.5]), np.linspace(-0.2, 0.4, 301)
    poses = compose(np.array([1.0, 2.0, 0.3]), exp(seconds[:, None] * twist))
    known = KnownPoses(Trajectory(np.rint(S + seconds * S).astype(np.int64), poses))
    times = np.linspace(0.0, 0.1, 30)
    walls = np.stack([np.linspace(3, 6, 30), np.linspace(-1, 4, 30)], axis=1)
    at = compose(np.array([1.0, 2.0, 0.3]), exp(times[:, None] * twist))
    seen = np.stack([transform_points(inverse(pose), wall) for pose, wall in zip(at, walls, strict=True)])
    geometry = ScanGeometry(np.arctan2(seen[:, 1], seen[:, 0]))
    scan = LaserScan.from_ranges(S, np.hypot(*seen.T), geometry, beam_times_s=times)
    sharp = known.deskew(scan.beams(0.05, 30.0))
    np.testing.assert_allclose(transform_points(known.at(S), sharp.ends), walls, atol=1e-5)
    assert np.abs(transform_points(known.at(S), scan.beams(0.05, 30.0).ends) - walls).max() > 0.1
