"""Covariances of all poses: the closed form of drift against the graph's marginals, and what lies between key scans."""

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose, rotate_covariances
from gridslam.slam.full_slam import full_trajectory
from gridslam.slam.full_slam.full_trajectory import (
    TrackedScans,
    drift_covariances,
    find_open_directions,
    path_fractions,
    scan_covariances,
)
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph


def chain(steps, seed=0):
    """Poses far from the origin, joined by exact increments of given or drawn uncertainty."""
    rng = np.random.default_rng(seed)
    increments = np.column_stack([rng.uniform(0.2, 1.0, steps), rng.normal(0, 0.1, (steps, 2)) * [1, 3]])
    poses = [np.array([300.0, -200.0, 2.0])]
    for increment in increments:
        poses.append(compose(poses[-1], increment))
    position, heading = rng.uniform(1e2, 1e5, (2, steps))
    information = np.stack([np.diag([p, p, h]) for p, h in zip(position, heading, strict=True)])
    edges = np.stack([np.arange(steps), np.arange(1, steps + 1)], axis=1)
    return PoseGraph.of(np.array(poses), edges, increments, information)


@pytest.mark.parametrize("steps", [1, 2, 200])
def test_drift_is_what_the_graph_of_increments_leaves(steps):
    graph = chain(steps)
    expected = marginal_covariances(graph)
    # the moments are about the origin, 400 m away: their differences lose 6 of 16 digits
    assert np.allclose(drift_covariances(graph), expected, rtol=1e-8, atol=1e-9)


def test_between_key_scans_it_is_no_less_than_drift_and_at_them_it_is_theirs():
    graph = chain(3)
    of_keys = drift_covariances(graph)
    keys = np.array([0, 0, 0, 1, 1, 2, 2, 3, 3])
    steps = graph.measurements
    at = np.array([0.0, 0.3, 0.6, 1.0, 0.5, 1.0, 0.25, 1.0, 0.0])  # share of the way since the key scan before
    before = np.array([0, 0, 0, 0, 1, 1, 2, 2, 0])
    key_from_base = steps[before] * at[:, None]
    key_from_base[0], key_from_base[-1] = 0.0, (0.4, 0.0, 0.1)
    assert path_fractions(keys, key_from_base)[[0, 3, 5, 7]].tolist() == [0, 0, 0, 0]
    found = scan_covariances(graph, of_keys, np.zeros((9, 3)), [TrackedScans(keys, key_from_base)], DriftModel())
    assert np.array_equal(found[[0, 3, 5, 7]], of_keys)
    for scan in (1, 2, 4, 6):
        k, share = keys[scan], path_fractions(keys, key_from_base)[scan]
        drifted = (1 - share) * of_keys[k] + share * of_keys[k + 1]  # of a random walk, exactly
        assert np.linalg.eigvalsh(found[scan] - drifted).min() >= -1e-12
        assert np.linalg.eigvalsh(found[scan]).min() > 0
    driven = rotate_covariances(DriftModel().covariance(key_from_base[8]), graph.poses[-1, 2])
    assert np.allclose(found[8], of_keys[3] + driven)


def test_the_scale_of_the_map_is_no_better_known_for_what_was_measured(monkeypatch):
    """A pose d m from the first one is uncertain by d times the scale's standard deviation, along the line to it."""
    graph = chain(3)
    keys = np.arange(4)
    drives = [TrackedScans(keys, np.concatenate([np.zeros((1, 3)), graph.measurements]))]
    covariances = []
    for sigma in (0, 0.01):
        monkeypatch.setattr(full_trajectory, "_SCALE_SIGMA", sigma)
        covariances.append(scan_covariances(graph, drift_covariances(graph), graph.poses, drives, DriftModel()))
    without, scaled = covariances
    for pose, added in zip(graph.poses, scaled - without, strict=True):
        away = pose - graph.poses[0]
        away[2] = 0.0
        np.testing.assert_allclose(added, 1e-4 * np.outer(away, away), atol=1e-15)


def test_a_match_between_key_scans_and_the_motion_add_their_information():
    """Beside the error of the key scans, which it does not show; as much as the motion knows halves its variance."""
    graph = chain(1)
    keys, share = np.array([0, 0, 1]), 0.5
    moved = np.stack([np.zeros(3), share * graph.measurements[0], graph.measurements[0]])
    drives = [TrackedScans(keys, moved)]
    poses = graph.poses[[0, 0, 1]]  # the scale's error aside
    of_keys = np.zeros((2, 3, 3))
    by_motion = scan_covariances(graph, of_keys, poses, drives, DriftModel())[1]
    poses[1, 2] = graph.poses[1, 2] + 0.7
    in_scan = np.linalg.inv(rotate_covariances(by_motion[None], -poses[1:2, 2]))
    information = np.concatenate([np.zeros((1, 3, 3)), in_scan, np.zeros((1, 3, 3))])
    found = scan_covariances(graph, of_keys, poses, drives, DriftModel(), information)[1]
    np.testing.assert_allclose(found, by_motion / 2, atol=1e-12)


def test_open_directions_are_those_along_which_increments_are_uncertain():
    """Whatever the heading: the axis is given in the frame in which an increment ends."""
    poses = np.array([[0.0, 0, 0], [1, 0, 0.3], [2, 1, 2.0]])
    sigmas = np.array([[0.015, 0.01], [0.3, 0.01]])  # along x and y of the frame in which each ends
    information = np.stack([np.diag([*(1 / np.square(s)), 1e4]) for s in sigmas])
    edges = np.array([[0, 1], [1, 2]])
    graph = PoseGraph.of(poses, edges, between(poses[:-1], poses[1:]), information)
    (line,) = find_open_directions(graph)
    assert line.reshape(2, 2).mean(axis=0) == pytest.approx(poses[2, :2])
    dx, dy = line[2:] - line[:2]
    assert abs(dx * np.sin(2.0) - dy * np.cos(2.0)) < 1e-9
