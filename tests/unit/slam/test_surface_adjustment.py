"""Scans are adjusted to within what their beams allow, from where they are a few centimetres off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridslam.evaluation import absolute_errors
from gridslam.geometry.se2 import between, compose, rotate_covariances
from gridslam.matching.surfaces import Surfaces
from gridslam.slam.full_slam import full_trajectory, surface_adjustment
from gridslam.slam.full_slam.full_trajectory import (
    TrackedScans,
    drift_covariances,
    path_fractions,
    scan_covariances,
)
from gridslam.slam.full_slam.key_covariances import key_covariances
from gridslam.slam.full_slam.surface_adjustment import adjust_key_scans, match_scans, share_information
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.pose_graph.marginals import marginal_covariances
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import Trajectory
from support import hall


@pytest.fixture(scope="module")
def seen():
    return hall.key_scans(hall.drive(1))


@pytest.fixture(scope="module")
def archive(seen):
    made = ScanArchive()
    for beams, pose in zip(seen.beams, seen.truth, strict=True):
        made.append(beams, pose, is_key=True)
    return made


def graph_about(truth, seed, sigma_m=0.02, sigma_rad=0.005):
    """Increments that are said to be as inexact as they are."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(len(truth) - 1, 3)) * [sigma_m, sigma_m, sigma_rad]
    increments = compose(between(truth[:-1], truth[1:]), noise)
    poses = [truth[0]]
    for increment in increments:
        poses.append(compose(poses[-1], increment))
    information = np.diag(1 / np.square([sigma_m, sigma_m, sigma_rad]))
    edges = np.stack([np.arange(len(truth) - 1), np.arange(1, len(truth))], axis=1)
    return PoseGraph.of(np.array(poses), edges, increments, np.tile(information, (len(increments), 1, 1)))


def errors(poses, truth):
    stamps = np.arange(len(truth))
    found = absolute_errors(Trajectory(stamps, poses), Trajectory(stamps, truth))
    return found.trans_rmse_m, found.rot_rmse_deg


@pytest.mark.parametrize("seed", range(3))
def test_key_scans_end_up_where_their_surfaces_fit(seen, archive, seed):
    """A lap of 24 m x 16 m with a range noise of 1 cm; from more than 5 cm off to less than 2 cm."""
    until = 90
    graph = graph_about(seen.truth[:until], seed)
    batch = archive.batch(archive.keys[:until])
    before, after = (errors(poses, seen.truth[:until]) for poses in (graph.poses, adjust(graph, batch)[0].poses))
    assert before[0] > 0.05
    assert after[0] < 0.02
    assert after[1] < 0.1


def adjust(graph, batch):
    surfaces = Surfaces.of(batch)
    return adjust_key_scans(graph, surfaces, surfaces, np.zeros(len(graph.poses), np.int64))


def test_rounds_are_repeated_until_visits_are_together(seen, archive, monkeypatch):
    """Two laps whose increments all turn by 0.2 degrees too much, far more than they are said to err by together.

    With a single round for each gate the visits stay metres apart.
    """
    truth = seen.truth
    turned = compose(between(truth[:-1], truth[1:]), np.array([0.0, 0.0, 0.003]))
    poses = [truth[0]]
    for increment in turned:
        poses.append(compose(poses[-1], increment))
    edges = np.stack([np.arange(len(turned)), np.arange(1, len(truth))], axis=1)
    information = np.tile(np.diag(1 / np.square([0.02, 0.02, 0.005])), (len(turned), 1, 1))
    graph = PoseGraph.of(np.array(poses), edges, turned, information)
    batch = archive.batch(archive.keys)

    def apart_m(poses):
        """Greatest error of where the second lap has a key scan, seen from one of the first lap near it."""
        away = np.hypot(*(truth[:, None, :2] - truth[None, :, :2]).T)
        first, second = np.nonzero(np.triu((away < 1.0).T, k=40))
        return np.abs(between(poses[first], poses[second]) - between(truth[first], truth[second]))[:, :2].max()

    assert apart_m(graph.poses) > 4.0
    assert apart_m(adjust(graph, batch)[0].poses) < 0.03
    monkeypatch.setattr(surface_adjustment, "_MOST_ROUNDS", 1)
    assert apart_m(adjust(graph, batch)[0].poses) > 2.0


def test_covariances_of_the_adjusted_graph_are_of_the_errors_size(seen, archive):
    """Of six numbers in a room, by the normalized squares of the errors: 3 is expected; the lap's are not independent.

    If a scan counted fully in each of its pairs, they would be of a tenth of the errors' squares and less.
    """
    until = 60
    batch = archive.batch(archive.keys[:until])
    truth = between(seen.truth[0], seen.truth[:until])
    claimed, bold = [], []
    for seed in range(4):
        graph = graph_about(truth, seed)
        found, variance = adjust(graph, batch)
        assert np.sqrt(variance) == pytest.approx(0.009, abs=0.0015)  # of ranges 1 cm, of which grazed walls show less
        assert len(found.edges) > 3 * len(graph.edges)
        counts = np.bincount(found.edges[len(graph.edges) :].ravel()).mean()
        whole = found.information.copy()
        whole[len(graph.edges) :] *= counts / 2
        for squares, by in ((claimed, found), (bold, replace(found, information=whole))):
            errors = between(truth, found.poses)[1:]
            errors[:, :2] = (found.poses - truth)[1:, :2]
            covariances = key_covariances(by)[1:]
            squares.append(np.einsum("ki,kij,kj->k", errors, np.linalg.inv(covariances), errors).mean())
    assert 0.3 < np.mean(claimed) < 4.5 < np.mean(bold)


def test_scans_between_key_scans_are_matched_to_those_about_them(seen, archive):
    """Every third is a key scan; the others begin 3 cm and half a degree off."""
    keys = np.arange(0, 120, 3)
    made = ScanArchive()
    for k in range(120):
        made.append(seen.beams[k], seen.truth[k], is_key=k % 3 == 0)
    rng = np.random.default_rng(2)
    begun = compose(seen.truth[:120], rng.normal(size=(120, 3)) * [0.03, 0.03, 0.01])
    begun[keys] = seen.truth[keys]
    surfaces = Surfaces.of(made.batch(made.keys))
    found, information = match_scans(begun, np.arange(120) // 3, made, surfaces, seen.truth[keys], 1e-4)
    np.testing.assert_array_equal(found[keys], seen.truth[keys])
    off = between(seen.truth[:120], found)
    assert np.sqrt(np.square(off[:, :2]).sum(axis=1).mean()) < 0.02
    assert np.degrees(np.sqrt(np.square(off[:, 2]).mean())) < 0.15
    is_between = np.arange(120) % 3 > 0
    assert not information[~is_between].any()
    squares = np.einsum("ki,kij,kj->k", off, information, off)[is_between]
    assert 1.5 < squares.mean() < 6.0  # of three numbers each, beside those of the key scans that they were matched to


def test_key_scans_are_not_matched_across_a_gap_that_nothing_joins(seen, archive):
    batch = archive.batch(archive.keys[:90])
    surfaces = Surfaces.of(batch)
    components = np.repeat([0, 1], 45)
    graph = graph_about(seen.truth[:90], 1)
    whole, apart = (adjust_key_scans(graph, surfaces, surfaces, of)[0] for of in (0 * components, components))
    joining, none = (np.diff(components[found.edges[len(graph.edges) :]])[:, 0].any() for found in (whole, apart))
    assert joining
    assert not none


def test_frozen_key_scans_stay(seen, archive):
    graph = replace(graph_about(seen.truth[:90], 1), held=40)
    poses = adjust(graph, archive.batch(archive.keys[:90]))[0].poses
    np.testing.assert_array_equal(poses[:40], graph.poses[:40])
    assert np.abs(poses[40:] - graph.poses[40:]).max() > 0.01


@pytest.mark.parametrize("scans", [2, 5, 30])
def test_pairs_share_the_information_that_a_surface_leaves_which_is_not_known_itself(scans):
    """One point on a line that all scans see, eliminated: (I - 1 1' / scans) / sigma^2 of their positions."""
    sigma = 0.01
    joint = np.eye(scans + 1) / sigma**2  # of the positions, and of the point
    joint[-1, -1] *= scans
    joint[-1, :-1] = joint[:-1, -1] = -1 / sigma**2
    expected = joint[:-1, :-1] - np.outer(joint[:-1, -1], joint[-1, :-1]) / joint[-1, -1]
    pairs = np.array([(j, k) for k in range(scans) for j in range(k)])
    found = np.zeros((scans, scans))
    for pair, share in zip(pairs, share_information(pairs), strict=True):
        found[np.ix_(pair, pair)] += share / (2 * sigma**2) * np.array([[1, -1], [-1, 1]])
    np.testing.assert_allclose(found, expected, atol=1e-9 / sigma**2)


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
