"""The graph of key scans: how uncertain one is as seen from another, by which way, and what corrections leave of it."""

import copy
import itertools
import math

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.serialization import from_arrays, to_arrays
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel, propagate_covariances
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, UNKNOWN_VARIANCES, KeyGraph, position_sigmas
from gridslam.tracking.state import UnmatchedMotion

DRIFT = DriftModel()


def steps(count, seed=0):
    """Increments (count, 3) of a drive that turns now and then, and their variances; half a metre each."""
    rng = np.random.default_rng(seed)
    moved = np.column_stack([rng.uniform(0.3, 0.6, count), rng.normal(scale=0.02, size=count), np.zeros(count)])
    moved[:, 2] = np.where(rng.random(count) < 0.2, rng.normal(scale=0.8, size=count), 0.0)
    return moved, [DRIFT.variances(math.hypot(x, y), abs(turn)) for x, y, turn in moved]


def chain(count, seed=0, start=(300.0, 200.0, 0.7)):
    """A graph of `count` key scans without any tie; the map's frame is not the tracker's."""
    graph, offset = KeyGraph(), np.array(start)
    tracked = np.zeros(3)
    graph.extend(tracked, offset, (1.0, 1.0))
    for moved, spread in zip(*steps(count - 1, seed), strict=True):
        tracked = compose(tracked, moved)
        graph.extend(tracked, compose(offset, tracked), spread)
    return graph


def constraint(graph, from_, to, information=1e6, off=(0.0, 0.0, 0.0)):
    """One that says what was tracked, or that and `off`."""
    measured = compose(between(graph.tracked[from_], graph.tracked[to]), np.array(off))
    return Constraint(from_, to, measured, information * np.eye(3), ConstraintSource.RECOGNIZED, determined=True)


def propagated(graph, keys):
    """Closed form: each step's position error stays as it is, its heading error turns all that follows about it."""
    x, y, _ = graph.poses[-1]
    total = np.zeros((3, 3))
    for k in keys:
        position, heading = graph.variances[k]
        across = np.array([graph.poses[k][1] - y, x - graph.poses[k][0], 1.0])
        total += np.diag([position, position, 0.0]) + heading * np.outer(across, across)
    return total


def contents(graph):
    """All that is saved, and what follows from it."""
    saved = {name: (array.shape, array.tobytes()) for name, array in to_arrays(graph).items()}
    tables = (graph._link_submaps, graph._links, graph._firsts, graph._steps)
    derived = [table.array.tobytes() for table in tables]
    return saved, np.array(graph._sums).tobytes(), derived, graph._link_places.copy(), graph._gap_counts.copy()


def nearby(graph, limit_m=1e3, most=10**6):
    return {found.submap: found for found in graph.find_nearby_submaps(len(graph) - 1, limit_m, most)}


def test_variances_of_an_increment_grow_with_metres_and_radians():
    still = DRIFT.variances(0.0, 0.0)
    assert still == (0.002**2, DRIFT.standstill_sigma_rad**2)
    straight = DRIFT.variances(4.0, 0.0)
    assert math.sqrt(straight[0] - still[0]) == pytest.approx(2 * DRIFT.sigma_m_per_sqrt_m)
    assert math.sqrt(straight[1] - still[1]) == pytest.approx(2 * DRIFT.sigma_rad_per_sqrt_m)
    turned = DRIFT.variances(0.0, 4.0)
    assert math.sqrt(turned[0] - still[0]) == pytest.approx(2 * DRIFT.sigma_m_per_sqrt_rad)
    assert math.sqrt(turned[1] - still[1]) == pytest.approx(2 * DRIFT.sigma_rad_per_sqrt_rad)


def test_what_no_match_has_measured_is_added_to_the_covariance():
    """An open direction along its axis, whatever the heading; a rejected match in all; the first in the heading."""
    moved = np.array([0.5, 0.0, 0.1])
    usual = DRIFT.covariance(moved)
    axis = np.array([math.cos(0.7), math.sin(0.7)])  # in the tracker's frame
    corridor = UnmatchedMotion(open_covariance=0.01 * np.outer(axis, axis))
    added = DRIFT.covariance(moved, corridor, 0.2) - usual
    seen = np.array([math.cos(0.5), math.sin(0.5)])  # from the heading 0.2
    np.testing.assert_allclose(added[:2, :2], 0.01 * np.outer(seen, seen), atol=1e-12)
    assert added[2, 2] == pytest.approx((DRIFT.open_heading_ratio**2 - 1) * usual[2, 2])
    rejected = DRIFT.covariance(moved, UnmatchedMotion(0.02, 0.03)) - usual
    np.testing.assert_allclose(rejected, 1.5**2 * np.diag([0.02, 0.02, 0.03]), atol=1e-12)
    first = DRIFT.covariance(moved, first=True) - usual
    np.testing.assert_allclose(first, np.diag([0, 0, 0.004**2]), atol=1e-15)
    assert (
        DRIFT.bounds(moved, corridor)[0] > np.linalg.eigvalsh(DRIFT.covariance(moved, corridor)[:2, :2]).max()
    )  # searches are generous


@pytest.mark.parametrize("count", [1, 7, 10, 11, 95])
def test_along_a_chain_the_covariance_is_the_propagated_one(count):
    graph = chain(count)
    found = graph.find_nearby_submaps(len(graph) - 1, 1e3, 10**6)
    assert [f.submap for f in found] == list(range((count - 1) // KEY_SCANS_PER_SUBMAP, -1, -1))
    for submap, pose, covariance in found:
        np.testing.assert_allclose(
            pose, between(graph.tracked[submap * KEY_SCANS_PER_SUBMAP], graph.tracked[-1]), atol=1e-9
        )
        expected = propagated(graph, range(submap * KEY_SCANS_PER_SUBMAP + 1, count))
        np.testing.assert_allclose(covariance, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("start", [(-300.0, 200.0, 1.0), (300.0, -200.0, -2.0), (-9.0, -9.0, 3.0)])
def test_the_covariance_does_not_depend_on_where_the_map_has_its_origin(start):
    here, there = chain(64), chain(64, start=start)
    turn = start[2] - here.poses[0][2]
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    for one, other in zip(
        here.find_nearby_submaps(len(here) - 1, 1e3, 100),
        there.find_nearby_submaps(len(there) - 1, 1e3, 100),
        strict=True,
    ):
        assert one.submap == other.submap
        expected = rotation @ one.covariance @ rotation.T
        np.testing.assert_allclose(other.covariance, expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_no_way_through_the_graph_is_more_certain(seed):
    """Against all ways without a cycle; the trace of the position's covariance is additive along a way."""
    graph = chain(68, seed)
    rng = np.random.default_rng(seed)
    for _ in range(4):
        from_, to = sorted(rng.choice(68, 2, replace=False).tolist())
        if to // KEY_SCANS_PER_SUBMAP > from_ // KEY_SCANS_PER_SUBMAP + 1:
            graph.add(constraint(graph, from_, to, float(rng.choice([1e2, 1e4]))))
    ways = {submap: {} for submap in range(7)}
    for (a, b), link in zip(graph._link_submaps.array.tolist(), graph._links.array, strict=True):
        ways[a][b] = link[3:]
    for submap, moments in enumerate(graph._steps.array):
        ways[submap][submap + 1] = ways[submap + 1][submap] = moments
    least = dict.fromkeys(range(6), np.inf)
    start = graph._sums[-1] - graph._sums[60]
    for length in range(1, 7):
        for way in itertools.permutations(range(6), length):
            hops = list(itertools.pairwise((6, *way)))
            if all(b in ways[a] for a, b in hops):
                total = start + sum(ways[a][b] for a, b in hops)
                covariance = propagate_covariances(graph.poses[-1], total[None])[0]
                least[way[-1]] = min(least[way[-1]], np.trace(covariance[:2, :2]))
    found = nearby(graph)
    for submap, variance in least.items():
        assert np.trace(found[submap].covariance[:2, :2]) == pytest.approx(variance, rel=1e-9)
    traces = [np.trace(f.covariance[:2, :2]) for f in found.values()]
    assert traces == sorted(traces)


def bent(graph, seed=3):
    """Other poses of the key scans: another frame, and a bend in it."""
    poses = compose(np.array([500.0, 400.0, -0.2]), np.array(graph.poses))
    half = len(poses) // 2
    poses[half:] = compose(poses[half], compose(np.array([0.0, 0.0, 0.3]), between(poses[half], poses[half:])))
    return poses


def test_a_correction_moves_poses_and_keeps_constraints():
    graph = chain(200)
    graph.add(constraint(graph, 15, 185, off=(0.4, -0.3, 0.1)))
    constraints, before = copy.deepcopy(graph.constraints), nearby(graph)
    poses = bent(graph)
    graph.correct(poses)
    np.testing.assert_array_equal(np.array(graph.poses), poses)
    for one, other in zip(graph.constraints, constraints, strict=True):
        assert (one.from_, one.to, one.source) == (other.from_, other.to, other.source)
        np.testing.assert_array_equal(one.measurement, other.measurement)
    after = nearby(graph)
    for submap in range(20):  # relative poses are as tracked and as tied, whatever the map's poses
        np.testing.assert_allclose(after[submap].pose, before[submap].pose, atol=1e-12)
    for submap in (19, 18, 17):
        expected = propagated(graph, range(submap * KEY_SCANS_PER_SUBMAP + 1, 200))
        np.testing.assert_allclose(after[submap].covariance, expected, rtol=1e-6, atol=1e-9)
    assert {1, 2, 0} < set(list(after)[:12])


def test_near_in_time_things_lie_as_tracked_and_else_as_in_the_map():
    graph = chain(100)
    graph.correct(bent(graph))
    np.testing.assert_array_equal(graph.relative_pose(50, 80), between(graph.tracked[50], graph.tracked[80]))
    np.testing.assert_array_equal(graph.relative_pose(40, 80), between(graph.poses[40], graph.poses[80]))


def go_on(graph):
    """What may happen next: more scans, a tie, a correction, more scans."""
    moved, spread = steps(40, seed=9)
    for k, (increment, variances) in enumerate(zip(moved, spread, strict=True)):
        tracked = compose(graph.tracked[-1], increment)
        graph.extend(tracked, compose(graph.poses[-1], increment), variances)
        if k == 10:
            graph.add(constraint(graph, 25, len(graph) - 1))
        if k == 20:
            graph.correct(bent(graph))
    found = graph.find_nearby_submaps(len(graph) - 1, 1e3, 100)
    return contents(graph), [(f.submap, f.pose.tobytes(), f.covariance.tobytes()) for f in found]


@pytest.mark.parametrize("count", [1, 64])
def test_arrays_and_snapshots_go_on_to_the_same_bytes(count):
    graph = chain(count)
    if count > 30:
        graph.add(constraint(graph, 5, 60, off=(0.1, 0.0, 0.0)))
        graph.add(constraint(graph, 15, 62))
    before = contents(graph)
    kept, read = graph.snapshot(), from_arrays(KeyGraph, to_arrays(graph))
    assert contents(kept) == contents(read) == before
    assert [t.source for t in read.constraints] == [t.source for t in graph.constraints]
    if count == 1:
        return
    end = go_on(graph)
    assert contents(kept) == before  # what was done to the one has not reached the other
    assert go_on(read) == end
    assert go_on(kept) == end


@pytest.mark.parametrize("seed", range(10))
def test_a_graph_that_is_read_knows_the_same_ways_to_the_last_bit(seed):
    """Whatever was found when: ties of key scans long past, corrections, and a drive that was found in another one."""
    rng = np.random.default_rng(seed)
    graph = chain(30, seed)
    for k, (increment, variances) in enumerate(zip(*steps(60, seed + 100), strict=True)):
        tracked = compose(graph.tracked[-1], increment)
        graph.extend(tracked, compose(graph.poses[-1], increment), variances)
        for to in rng.integers(20, len(graph), rng.integers(0, 3)).tolist():
            graph.add(constraint(graph, int(rng.integers(0, to - 10)), to, information=10 ** rng.uniform(2, 6)))
        if k == 20:
            graph.correct(bent(graph))
        if k == 40:
            own, graph = graph, chain(40, seed + 1)
            first = len(graph)
            graph.append(own, compose(graph.poses[20], np.array(own.poses)), UNKNOWN_VARIANCES)
            for to in (9, 25, 60):
                graph.add(constraint(graph, 12, first + to))
        read = from_arrays(KeyGraph, to_arrays(graph))
        assert contents(read) == contents(graph)
        assert read.drift.tobytes() == graph.drift.tobytes()


def test_a_gap_within_a_submap_makes_what_lies_behind_it_uncertain():
    """Between the first key scan of the submap and the one that is asked for."""
    graph = KeyGraph()
    for key in range(30):
        pose = np.array([0.5 * key, 0.0, 0.0])
        graph.extend(pose, pose, (4.0, 0.2) if key == 5 else (1e-4, 1e-6))
    _, covariances = graph.locate(2, np.array([1, 8]))
    near, behind = position_sigmas(covariances)
    assert near < 0.1
    assert behind >= 2.0
