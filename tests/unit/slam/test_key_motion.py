"""The odometry weighs in the motion between key scans where it is known to be good, and not where wheels slip."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.slam.full_slam.key_motion import weigh_odometry
from gridslam.slam.loop_closure.constraints import (
    Constraint,
    ConstraintSource,
)
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.key_graph import UNKNOWN_VARIANCES, KeyGraph
from gridslam.tracking.state import UnmatchedMotion
from gridslam.types import Match

COUNT = 120
SCALE = 1.03
SLIPPED = 50
GAP = 70
STEP = np.array([0.5, 0.0, 0.06])


def drive(seed, odometry_sigma_m=0.005, tracked_sigma_m=0.02):
    """A circle: key scans, where they are, and a graph of increments as they were tracked."""
    rng = np.random.default_rng(seed)
    variances = DriftModel().variances(0.5, 0.06)
    covariance = DriftModel().covariance((0.5, 0.0, 0.06))
    keys = KeyGraph()
    odometry = tracked = true = np.zeros(3)
    truth = []
    for key in range(COUNT):
        gap = (1.0, 1.0) if key == GAP else variances
        keys.extend(tracked, true, gap, covariance, odometry=odometry)
        truth.append(true)
        true = compose(true, STEP)
        tracked = compose(tracked, STEP + np.array([rng.normal(scale=tracked_sigma_m), 0.0, 0.0]))
        metres = 1.0 if key == SLIPPED - 1 else SCALE * (STEP[0] + rng.normal(scale=odometry_sigma_m))
        odometry = compose(odometry, np.array([metres, 0.0, STEP[2]]))
    keys.correct(np.array(truth))
    graph = keys.graph()
    return keys, replace(graph, information=np.tile(np.linalg.inv(covariance), (COUNT - 1, 1, 1)))


def weighed(keys, graph):
    return weigh_odometry(graph, keys, np.diff(keys.label_gaps()) == 0)


@pytest.mark.parametrize("seed", range(3))
def test_good_odometry_corrects_what_was_tracked_badly(seed):
    """Its scale is 3 % wrong, 1.5 cm each step, which is learned."""
    keys, graph = drive(seed)
    along = [np.delete(found.errors()[:, 0], [SLIPPED - 1, GAP - 1]) for found in (graph, weighed(keys, graph))]
    before, after = (np.sqrt(np.mean(np.square(errors))) for errors in along)
    assert before > 0.015
    assert after < 0.6 * before


def test_the_tracked_motion_stays_where_wheels_slip_and_across_gaps():
    keys, graph = drive(0)
    found = weighed(keys, graph)
    for step in (SLIPPED - 1, GAP - 1):
        assert found.measurements[step] == pytest.approx(graph.measurements[step], abs=4e-3)
        assert found.information[step] == pytest.approx(graph.information[step], rel=0.06)
    assert np.trace(found.information[10]) != pytest.approx(np.trace(graph.information[10]), rel=0.03)


def test_a_jump_of_the_filter_is_none_where_odometry_and_tracking_agree():
    keys, graph = drive(0)
    graph.measurements[30, 0] += 0.3
    assert weighed(keys, graph).errors()[30, 0] == pytest.approx(0, abs=0.03)


def test_jumps_of_the_filter_do_not_make_the_odometry_unknown():
    """A filter with a narrow laser may jump by decimetres again and again, where tracking and wheels agree."""
    keys, graph = drive(0)
    jumps = np.zeros((COUNT, 3))
    jumps[:, 0] = np.random.default_rng(1).normal(scale=0.2, size=COUNT)
    jumping = graph.with_poses(compose(graph.poses, jumps))
    assert weighed(keys, jumping).measurements == pytest.approx(weighed(keys, graph).measurements)
    assert weighed(keys, jumping).measurements[30, 0] != graph.measurements[30, 0]


def test_bad_odometry_takes_the_place_of_nothing():
    """Of 3 cm a step it brings a fifteenth of the information: what was tracked keeps most of its own."""
    keys, graph = drive(0, odometry_sigma_m=0.04)
    assert np.median(weighed(keys, graph).information[:, 0, 0] / graph.information[:, 0, 0]) > 0.6


def test_without_odometry_nothing_changes():
    keys, graph = drive(0)
    keys.odometry = [np.full(3, np.nan)] * COUNT
    assert weighed(keys, graph) is graph


def test_key_scans_keep_their_odometry_when_drives_are_joined_thinned_and_cut():
    keys, _ = drive(0)
    first, later = keys.snapshot(), keys.snapshot()
    first.append(later, np.array(later.poses), UNKNOWN_VARIANCES)
    kept = np.arange(COUNT, 2 * COUNT)
    expected = np.tile(np.array(keys.odometry), (2, 1))
    thinned = first.select(kept)
    assert np.array_equal(thinned.odometry, expected[kept])
    thinned.truncate(10)
    assert np.array_equal(thinned.odometry, expected[kept[:10]])


def test_a_direction_left_open_leaves_the_heading_of_searches_as_uncertain_as_it_is_expected():
    """Two parallel walls determine the heading less than a room, whatever it is asked for."""
    moved = (0.5, 0.0, 0.1)
    corridor = UnmatchedMotion(open_covariance=np.diag([0.1, 0.0]))
    (_, closed), (position, heading) = (DriftModel().bounds(moved, it) for it in (UnmatchedMotion(), corridor))
    assert heading == pytest.approx(DriftModel().open_heading_ratio ** 2 * closed)
    assert heading == pytest.approx(DriftModel().covariance(moved, corridor)[2, 2])
    assert position > 0.1


SIGMA_M = 0.3
FLOOR = 1e-2
"""Information of a direction left open: 10 m, 10 rad."""


def match_at(pose, information, score=100.0):
    return Match(np.array([pose]), np.array([information]), np.array([score]))


@pytest.mark.parametrize("heading", [0.0, math.pi / 2, -2.3])
def test_a_constraint_weighs_a_displacement_in_the_submap_as_the_match_does(heading):
    """e' Omega e = d' I d for a small displacement d in the submap's frame, and e = between(measured, displaced)."""
    rng = np.random.default_rng(0)
    factor = rng.normal(size=(3, 3))
    information, pose = 100 * (factor @ factor.T + np.eye(3)), np.array([2.0, -1.0, heading])
    constraint = Constraint.from_match(
        3, 40, pose + 0.1, match_at(pose, information), SIGMA_M, 0.1, ConstraintSource.TRACKED
    )
    assert (constraint.from_, constraint.to, constraint.source, constraint.determined) == (
        3,
        40,
        ConstraintSource.TRACKED,
        True,
    )
    np.testing.assert_array_equal(constraint.measurement, pose)
    for away in rng.normal(scale=0.1, size=(5, 3)):
        error = between(pose, pose + away)
        expected = away @ information @ away / SIGMA_M**2 + FLOOR * error @ error
        assert error @ constraint.information @ error == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("axis_rad", [0.0, 0.4, math.pi / 2, 2.5])
@pytest.mark.parametrize("heading", [0.0, -2.3])
def test_along_an_open_direction_the_guess_is_kept_and_nothing_is_weighed(axis_rad, heading):
    """A corridor along `axis_rad`: 40 beams across it, 1 along it, none of them coupled with the heading's 500."""
    along = np.array([math.cos(axis_rad), math.sin(axis_rad)])
    across = np.array([-along[1], along[0]])
    information = np.zeros((3, 3))
    information[:2, :2] = np.outer(along, along) + 40 * np.outer(across, across)
    information[2, 2] = 500.0
    guess, pose = np.array([1.0, 2.0, heading - 0.02]), np.array([1.3, 1.9, heading])
    constraint = Constraint.from_match(
        5, 90, guess, match_at(pose, information), SIGMA_M, 0.1, ConstraintSource.PROXIMITY
    )
    assert not constraint.determined
    assert constraint.measurement[2] == heading
    assert along @ constraint.measurement[:2] == pytest.approx(along @ guess[:2])
    assert across @ constraint.measurement[:2] == pytest.approx(across @ pose[:2])
    for direction, weight in ((along, 0.0), (across, 40.0)):
        error = between(constraint.measurement, constraint.measurement + np.append(direction, 0.0))
        assert error @ constraint.information @ error == pytest.approx(weight / SIGMA_M**2 + FLOOR)
    assert constraint.information[2, 2] == pytest.approx(500 / SIGMA_M**2 + FLOOR)
    assert np.linalg.eigvalsh(constraint.information)[0] > 0.99 * FLOOR
    np.testing.assert_array_equal(pose, [1.3, 1.9, heading])
