"""The odometry weighs in the motion between key scans where it is known to be good, and not where wheels slip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridslam.geometry.se2 import compose
from gridslam.slam.full_slam.key_motion import weigh_odometry
from gridslam.slam.full_slam.marginalization import marginalize
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.key_graph import UNKNOWN_VARIANCES, KeyGraph

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
    kept = np.arange(0, 2 * COUNT, 3)
    expected = np.tile(np.array(keys.odometry), (2, 1))
    thinned = marginalize(first, kept)
    assert np.array_equal(thinned.odometry, expected[kept])
    thinned.truncate(10)
    assert np.array_equal(thinned.odometry, expected[kept[:10]])
