"""The graph of key scans: how uncertain one is as seen from another, by which way, and what corrections leave of it."""

import copy
import math

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose, inverse
from gridslam.serialization import from_arrays, to_arrays
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel, compute_moments_of_variances, propagate_covariances
from gridslam.slam.loop_closure.key_graph import UNKNOWN_VARIANCES, KeyGraph, position_sigmas
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
    return saved, graph._sums.copy(), [link.pair for link in graph._links], graph._link_rows.copy()


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


@pytest.mark.parametrize("count", [2, 7, 95])
def test_along_a_chain_the_covariance_is_the_propagated_one(count):
    graph = chain(count)
    keys = np.arange(count)
    poses, covariances = graph.locate(count - 1, keys)
    for key, pose, covariance in zip(keys.tolist(), poses, covariances, strict=True):
        np.testing.assert_allclose(pose, between(graph.tracked[key], graph.tracked[-1]), atol=1e-9)
        np.testing.assert_allclose(covariance, propagated(graph, range(key + 1, count)), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("start", [(-300.0, 200.0, 1.0), (300.0, -200.0, -2.0), (-9.0, -9.0, 3.0)])
def test_the_covariance_does_not_depend_on_where_the_map_has_its_origin(start):
    turn = start[2] - chain(2).poses[0][2]
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    (_, here), (_, there) = (graph.locate(63, np.arange(0, 63, 7)) for graph in (chain(64), chain(64, start=start)))
    np.testing.assert_allclose(there, rotation @ here @ rotation.T, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_no_way_through_the_graph_is_more_certain(seed):
    """By relaxing all steps again and again; the trace of the position's covariance is additive along a way."""
    graph = chain(68, seed)
    rng = np.random.default_rng(seed)
    for _ in range(6):
        from_, to = sorted(rng.choice(68, 2, replace=False).tolist())
        if to > from_ + 10:
            graph.add(constraint(graph, from_, to, float(rng.choice([1e2, 1e4]))))
    variances = compute_moments_of_variances(np.array(graph.poses), np.array(graph.variances))
    steps = [(k - 1, k, variances[k]) for k in range(1, 68)]
    link_moments = np.frombuffer(graph._link_rows).reshape(-1, 11)[:, 2:]
    steps += [(*link.pair, moments) for link, moments in zip(graph._links, link_moments, strict=True)]
    least = np.full(68, np.inf)
    least[-1] = 0.0
    for _ in range(68):
        for a, b, moments in steps:
            variance = np.trace(propagate_covariances(graph.poses[-1], moments[None])[0, :2, :2])
            least[a], least[b] = min(least[a], least[b] + variance), min(least[b], least[a] + variance)
    poses, covariances = graph.locate(67, np.arange(68))
    np.testing.assert_allclose(np.trace(covariances[:, :2, :2], axis1=1, axis2=2), least, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(poses, between(np.array(graph.tracked), graph.tracked[-1]), atol=1e-9)
    assert (least[:40] < np.trace(chain(68, seed).locate(67, np.arange(40))[1][:, :2, :2], axis1=1, axis2=2)).any()


def test_a_way_by_a_constraint_leads_where_it_was_measured():
    """In either direction, and on along the increments behind it."""
    graph = chain(90)
    tie = constraint(graph, 10, 80, off=(0.4, -0.3, 0.1))
    graph.add(tie)
    seen = compose(
        between(graph.tracked[5], graph.tracked[10]), compose(tie.measurement, between(*graph.tracked[80:86:5]))
    )
    np.testing.assert_allclose(graph.locate(85, np.array([5]))[0][0], seen, atol=1e-9)
    np.testing.assert_allclose(graph.locate(5, np.array([85]))[0][0], inverse(seen), atol=1e-9)


@pytest.mark.parametrize("better", [0, 1])
@pytest.mark.parametrize("to", [6, 35])
def test_of_several_constraints_between_two_key_scans_a_way_comes_by_the_most_certain_one(better, to):
    """Beside the increment that joins them, too, and in either direction."""
    graph = chain(40)
    ties = []
    for k in range(2):
        information = np.diag([1e8, 1e8, 1e14]) if k == better else np.diag([1e7, 1e7, 1e14])
        ties.append(constraint(graph, 5, to, off=(0.1 * (1 + k), 0.0, 0.0))._replace(information=information))
    graph.add(ties[0])
    graph.add(ties[1]._replace(from_=to, to=5, measurement=inverse(ties[1].measurement)))
    (found,), covariances = graph.locate(to, np.array([5]))
    np.testing.assert_allclose(found, ties[better].measurement, atol=1e-9)
    np.testing.assert_allclose(np.trace(covariances[0]), 2e-8, rtol=1e-3)
    np.testing.assert_allclose(graph.locate(5, np.array([to]))[0][0], inverse(found), atol=1e-9)


def bent(graph, seed=3):
    """Other poses of the key scans: another frame, and a bend in it."""
    poses = compose(np.array([500.0, 400.0, -0.2]), np.array(graph.poses))
    half = len(poses) // 2
    poses[half:] = compose(poses[half], compose(np.array([0.0, 0.0, 0.3]), between(poses[half], poses[half:])))
    return poses


def test_a_correction_moves_poses_and_keeps_constraints():
    graph = chain(200)
    graph.add(constraint(graph, 15, 185, off=(0.4, -0.3, 0.1)))
    keys = np.arange(199)
    constraints, before = copy.deepcopy(graph.constraints), graph.locate(199, keys)[0]
    poses = bent(graph)
    graph.correct(poses)
    np.testing.assert_array_equal(np.array(graph.poses), poses)
    for one, other in zip(graph.constraints, constraints, strict=True):
        assert (one.from_, one.to, one.source) == (other.from_, other.to, other.source)
        np.testing.assert_array_equal(one.measurement, other.measurement)
    after, covariances = graph.locate(199, keys)
    near = np.r_[0:40, 170:199]  # which way is more certain to what lies between depends on the map's poses
    np.testing.assert_allclose(after[near], before[near], atol=1e-9)  # relative poses are as tracked and as tied
    for key in (190, 187):
        np.testing.assert_allclose(covariances[key], propagated(graph, range(key + 1, 200)), rtol=1e-6, atol=1e-9)


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
    found = graph.locate(len(graph) - 1, np.arange(len(graph)))
    return contents(graph), [each.tobytes() for each in found]


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


def test_a_reversed_constraint_weighs_the_same_errors_alike():
    """Whoever sees whom: chi2 is the same for errors of a tenth of a millimetre, but for terms of second order."""
    rng = np.random.default_rng(4)
    root = rng.normal(size=(3, 3))
    constraint = Constraint(2, 7, np.array([3.0, -1.5, 2.4]), root @ root.T, ConstraintSource.RECOGNIZED, True)
    reversed_ = constraint.reverse()
    assert reversed_.pair == (7, 2)
    for error in 1e-4 * rng.normal(size=(20, 3)):
        seen = compose(constraint.measurement, error)
        other = between(reversed_.measurement, inverse(seen))
        chi2 = error @ constraint.information @ error
        assert other @ reversed_.information @ other == pytest.approx(chi2, rel=3e-3)
