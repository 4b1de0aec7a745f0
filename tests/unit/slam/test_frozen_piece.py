"""A frozen piece: a later drive is aligned with it, online and at the end, and nothing of it moves by a bit."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import build
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between, compose
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.slam.full_slam.earlier_pieces import EarlierPieces
from gridslam.slam.full_slam.full_slam import full_slam, refine_piece
from gridslam.slam.full_slam.key_covariances import key_covariances
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.linear import initial_guess, linearize
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.slam.pose_graph.robust import CauchyEstimator, GraduatedNonConvexity
from support.loops import PROVOKED
from support.relative_covariances import relative_covariances

ELSEWHERE = np.array([30.0, -20.0, 2.0])


def drive(measurements, configuration, earlier=None, seed=0):
    """The state and the recorder of a drive; with earlier pieces it is located in them."""
    slam, recorder = build(configuration), TrajectoryRecorder()
    state = run(measurements[:1], slam, rng=np.random.default_rng(seed), observers=[recorder])
    if earlier is not None:
        state.closure_state.earlier = EarlierPieces(earlier, slam.mapper, slam.loop_closure.places)
    rng = np.random.default_rng(seed + 1)
    return run(measurements[1:], slam, rng=rng, observers=[recorder], state=state), recorder


def record(seed, first, last):
    """Scans of a lap through a suite of rooms, from waypoint `first` to `last`, and the true poses."""
    rng = np.random.default_rng(seed)
    world = make_world("rooms", rng)
    part = World.of("part", world.walls, world.route[first:last])
    log = simulate(part, RobotConfig(), OdometryNoise(), LidarConfig(beams=120, rate_hz=3.0), rng)
    return log.measurements, np.array(log.truth.poses)


@pytest.fixture(scope="module")
def days():
    """A frozen piece, a second day that begins elsewhere, its answer, and the true poses of both.

    The configuration closes a loop and corrects the past whenever it can, so that what must not move would.
    """
    (one, truth), (two, later_truth) = record(0, 0, 9), record(1, 3, 14)
    first, recorder = drive(one, PROVOKED)
    piece = MapPiece(first.closure_state.scans, first.closure_state.graph).freeze()
    later = [(replace(odometry, pose=compose(ELSEWHERE, odometry.pose)), scan) for odometry, scan in two]
    state, second = drive(later, PROVOKED, [piece])
    assert state.closure_state.joined == 0
    drives = [recorder.tracked_scans(), second.tracked_scans(len(piece))]
    answer = full_slam(state, drives, PROVOKED.mapper, PROVOKED.loop_closure)
    return piece, state, drives, answer, truth, later_truth


def test_no_key_scan_of_a_frozen_piece_moves_by_a_bit(days):
    piece, state, drives, answer, *_ = days
    assert state.closure_state.joined == 0
    old = piece.poses.tobytes()
    for poses in (
        np.array(state.closure_state.graph.poses),
        state.best_trajectory(),
        np.array(state.closure_state.online_poses),
        answer.graph.poses,
    ):
        assert poses[: len(piece)].tobytes() == old
    assert np.abs(answer.graph.poses - state.best_trajectory())[len(piece) :].max() > 1e-3  # what is new does
    assert answer.graph.held == len(piece)
    alone = full_slam_of(piece, drives[:1])
    count = len(drives[0].keys)
    assert answer.poses[:count].tobytes() == alone.poses[:count].tobytes()


def full_slam_of(piece, drives):
    return refine_piece(piece, drives, PROVOKED.mapper, PROVOKED.loop_closure)


def considered(graph):
    """Covariances of all poses, the held part's own and the others' given it with its error: dense, in closed form."""
    held, count = graph.held, len(graph.poses)
    blocks = linearize(graph, graph.poses, graph.errors())
    information = np.zeros((count, 3, count, 3))
    for (a, b), first, cross, second in zip(graph.edges, blocks.first, blocks.cross, blocks.second, strict=True):
        information[a, :, a] += first
        information[b, :, b] += second
        information[a, :, b] += cross
        information[b, :, a] += cross.T
    of_new = information.reshape(3 * count, -1)[3 * held :]
    given = np.linalg.inv(of_new[:, 3 * held :])
    gain = given @ of_new[:, : 3 * held]
    own = (graph.edges < held).all(axis=1)
    old = PoseGraph.of(graph.poses[:held], graph.edges[own], graph.measurements[own], graph.information[own])
    blocks = linearize(old, old.poses, old.errors())
    prior = np.zeros((held, 3, held, 3))
    for (a, b), first, cross, second in zip(old.edges, blocks.first, blocks.cross, blocks.second, strict=True):
        prior[a, :, a] += first
        prior[b, :, b] += second
        prior[a, :, b] += cross
        prior[b, :, a] += cross.T
    of_old = np.zeros((3 * held, 3 * held))
    of_old[3:, 3:] = np.linalg.inv(prior.reshape(3 * held, -1)[3:, 3:])
    whole = np.zeros((3 * count, 3 * count))
    whole[: 3 * held, : 3 * held] = of_old
    whole[3 * held :, 3 * held :] = given + gain @ of_old @ gain.T
    return np.array([whole[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] for k in range(count)])


@pytest.fixture
def walk():
    """30 poses of a walk; the last 12 come by the first 18, which are held, at one or several places."""

    def of(constraints):
        rng = np.random.default_rng(7)
        truth = [np.zeros(3)]
        for _ in range(29):
            truth.append(compose(truth[-1], np.array([0.5, 0.0, 0.3])))
        edges = np.array([(k, k + 1) for k in range(29)] + [(2, 12)] + constraints)
        truth = np.array(truth)
        noise = rng.normal(0, 1, (len(edges), 3)) * [0.02, 0.02, 0.01]
        information = np.tile(np.diag([2500.0, 2500.0, 1e4]), (len(edges), 1, 1))
        information[17] = 1e-6 * np.eye(3)  # where the later drive begins is not known
        measurements = compose(between(truth[edges[:, 0]], truth[edges[:, 1]]), noise)
        graph = PoseGraph.of(truth, edges, measurements, information)
        old = GraphSlam().solve(graph).poses
        return GraphSlam().solve(replace(graph, poses=old, held=18)).graph

    return of


def test_covariances_of_a_frozen_part_are_not_lowered_by_what_it_does_not_follow(walk):
    graph = walk([(5, 25), (6, 26), (9, 29)])
    found = key_covariances(graph)
    free = marginal_covariances(replace(graph, held=1))
    exact = considered(graph)
    np.testing.assert_allclose(found[:18], exact[:18], atol=1e-12)
    traces, least, true = (np.trace(c[:, :2, :2], axis1=1, axis2=2) for c in (found, free, exact))
    assert (traces >= least * (1 - 1e-9)).all()
    np.testing.assert_allclose(traces[18:], true[18:], rtol=0.25)


HELD = 7
SOLVERS = (
    GraphSlam(),
    GraphSlam(first_guess="given"),
    GraphSlam(first_guess="computed"),
    GraphSlam(robust=GraduatedNonConvexity()),
    GraphSlam(first_guess="given", robust=CauchyEstimator()),
)


@pytest.fixture
def graph():
    """A walk of 20 poses that comes by its first 7 again, with noise of the increments and between the walks."""
    rng = np.random.default_rng(3)
    truth = [np.array([0.3, -0.0, 0.5])]
    for _ in range(19):
        truth.append(compose(truth[-1], np.array([0.5, 0.0, 0.25])))
    truth = np.array(truth)
    edges = [(k, k + 1) for k in range(19)] + [(1, 18), (17, 2), (4, 13), (6, 11)]
    pairs = np.array(edges)
    noise = rng.normal(0, 1, (len(edges), 3)) * [0.02, 0.02, 0.01]
    measurements = compose(between(truth[pairs[:, 0]], truth[pairs[:, 1]]), noise)
    information = np.tile(np.diag([2500.0, 2500.0, 1e4]), (len(edges), 1, 1))
    off = truth + rng.normal(0, 0.03, truth.shape)
    off[0] = truth[0]  # a negative zero in it, which a sum with zero would lose
    return PoseGraph.of(off, edges, measurements, information, held=HELD)


@pytest.mark.parametrize("solver", SOLVERS, ids=repr)
def test_held_poses_stay_to_the_last_bit_and_the_others_do_not(graph, solver):
    solution = solver.solve(graph)
    assert solution.poses[:HELD].tobytes() == graph.poses[:HELD].tobytes()
    assert (np.abs(solution.poses - graph.poses)[HELD:, :2].max(axis=1) > 1e-4).all()
    assert solution.chi2_after < solution.chi2_before
    np.testing.assert_array_equal(initial_guess(graph)[:HELD], graph.poses[:HELD])


def test_held_is_what_very_certain_is(graph):
    """Poses that are held are those of a graph in which they are known to a micrometre from the first one."""
    sure = [(0, k) for k in range(1, HELD)]
    at = graph.poses
    certain = PoseGraph.of(
        at,
        np.concatenate([graph.edges, sure]),
        np.concatenate([graph.measurements, between(at[0], at[1:HELD])]),
        np.concatenate([graph.information, np.tile(1e12 * np.eye(3), (len(sure), 1, 1))]),
    )
    held = GraphSlam().solve(graph)
    free = GraphSlam(tolerance=1e-12).solve(certain)
    np.testing.assert_allclose(held.poses, free.poses, atol=1e-6)
    np.testing.assert_allclose(
        marginal_covariances(held.graph)[HELD:], marginal_covariances(free.graph)[HELD:], atol=1e-8
    )
    few = np.array([[2, HELD], [2, 12], [2, 19]])
    np.testing.assert_allclose(relative_covariances(held.graph, few), relative_covariances(free.graph, few), atol=1e-8)


def test_one_pose_between_two_that_are_held_is_their_weighted_mean():
    poses = np.array([[0.0, 0, 0], [2.0, 0, 0], [0.9, 0.4, 0.1]])
    precise = np.diag([300.0, 300.0, 1e6])
    graph = PoseGraph.of(
        poses, [(0, 2), (1, 2)], [[1.0, 0, 0], [-0.8, 0, 0]], [precise, np.diag([100.0, 100.0, 1e6])], held=2
    )
    solution = GraphSlam().solve(graph)
    np.testing.assert_allclose(solution.poses[2], [(300 * 1.0 + 100 * 1.2) / 400, 0, 0], atol=1e-9)
    covariances = marginal_covariances(solution.graph)
    np.testing.assert_allclose(covariances[2], np.diag([1 / 400, 1 / 400, 1 / 2e6]), atol=1e-6)
    assert not covariances[:2].any()


@pytest.mark.parametrize("held", [0, 21])
def test_at_least_one_pose_is_held_and_no_more_than_there_are(graph, held):
    with pytest.raises(ArgumentError, match="held: expected 1 to 20 poses"):
        PoseGraph.of(graph.poses, graph.edges, graph.measurements, graph.information, held=held)
