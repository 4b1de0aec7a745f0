"""The benchmark of recognition: its drives need it, its revisits are certain, and what is false is counted."""

from __future__ import annotations

import math

import numpy as np
import pytest

import recognition_drives as drives
import recognition_scores as scores
from gridslam.geometry.se2 import between
from gridslam.slam.pose_graph.pose_graph import PoseGraph

SURE = np.diag([400.0, 400.0, 1000.0])


@pytest.fixture(scope="module")
def rooms():
    return drives.simulated("rooms", 0)


def test_odometry_is_wrong_in_blackouts_and_nowhere_else(rooms):
    driven = drives.driven_m(rooms.truth)
    odometry = drives._misled(rooms.truth, driven, rooms.dark, drives._HONEST, np.random.default_rng(0))
    true, told = between(rooms.truth[:-1], rooms.truth[1:]), between(odometry[:-1], odometry[1:])
    dark = np.zeros(len(driven), bool)
    for begin, end in rooms.dark:
        assert 6 <= end - begin <= 10
        dark |= (driven > begin) & (driven < end)
    assert np.array_equal(np.flatnonzero(~dark), rooms.lit)
    np.testing.assert_allclose(told[~dark[1:]], true[~dark[1:]], atol=1e-9)
    assert 19 < abs(math.degrees((told - true)[dark[1:], 2].sum())) < 40
    longer = np.hypot(*told[dark[1:], :2].T).sum() / np.hypot(*true[dark[1:], :2].T).sum()
    assert 0.05 < abs(longer - 1) < 0.13


def test_the_second_lap_is_a_certain_revisit(rooms):
    arcs, driven = drives.certain_revisits(rooms), drives.driven_m(rooms.truth)
    assert len(arcs)
    for begin, end in arcs:
        assert begin >= drives.APART_M
        assert end - begin >= 2
        at = rooms.truth[(driven >= begin) & (driven <= end), :2]
        before = rooms.truth[driven <= begin - 20, :2]
        assert max(np.hypot(*(before - p).T).min() for p in at) < 3  # the laser sees farther than that


def lap() -> np.ndarray:
    """Poses (80, 3) of two laps of 40 m around a square, half a metre and more apart."""
    s = np.arange(80.0) % 40
    side, along = (s // 10).astype(int), s % 10
    x = np.choose(side, [along, 10, 10 - along, 0])
    y = np.choose(side, [0, along, 10, 10 - along])
    return np.column_stack([x, y, side * math.pi / 2])


def said(poses, *ties) -> scores.Mapped:
    """A run whose graph has ties (from, to, what the measurement errs by (3,), information)."""
    count = len(poses)
    edges = [(k, k + 1) for k in range(count - 1)] + [tie[:2] for tie in ties]
    i, j = np.array(edges).T
    measured = between(poses[i], poses[j])
    information = np.tile(SURE, (len(edges), 1, 1))
    for k, (*_, error, known) in enumerate(ties):
        measured[count - 1 + k] += error
        information[count - 1 + k] = known
    graph = PoseGraph.of(poses, edges, measured, information)
    return scores.Mapped(poses, poses, graph, np.arange(count), np.array([tie[:2] for tie in ties[:1]]), 0.0)


def judged(truth, run, arcs):
    return scores.judge(truth, drives.driven_m(truth), run, np.array(arcs))


def test_a_right_constraint_recognizes_the_revisit_that_it_ends_in():
    truth = lap()
    run = said(truth, (5, 45, (0.1, 0.0, 0.02), SURE), (6, 46, (0.0, 0.1, 0.0), SURE))
    assert judged(truth, run, [(44, 47), (60, 70)]) == (1, 2, 0, 0)
    assert judged(truth, said(truth), [(44, 47)]) == (0, 0, 0, 0)
