"""Places are recognized by submaps of the way, in sets that no other contradicts."""

import math

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, transform_points
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_features import extract_features, match_features
from gridslam.slam.loop_closure.submap_matching import propose_poses
from gridslam.slam.loop_closure.submap_recognition import SubmapRecognition


def corners(rng):
    """Ends of beams (B, 2) on the walls of boxes here and there."""
    along = np.linspace(0, 1, 80)
    boxes = []
    for x, y, width, height in rng.uniform([-15, -15, 1, 1], [15, 15, 5, 5], (25, 4)).tolist():
        for x0, y0, x1, y1 in ((0, 0, 1, 0), (1, 0, 1, 1), (1, 1, 0, 1), (0, 1, 0, 0)):
            boxes.append(
                np.stack([x + width * (x0 + (x1 - x0) * along), y + height * (y0 + (y1 - y0) * along)], axis=1)
            )
    return np.concatenate(boxes)


@pytest.mark.parametrize("seed", range(6))
def test_keypoints_turn_with_the_place(seed):
    """Seen from anywhere, at any heading, the keypoints propose the true pose; of another place none."""
    rng = np.random.default_rng(seed)
    points = corners(rng)
    pose = np.append(rng.uniform(-20, 20, 2), rng.uniform(-math.pi, math.pi))
    old, new = extract_features(points), extract_features(transform_points(between(pose, np.zeros(3)), points))
    best, *_ = propose_poses(old, new)
    assert np.hypot(*(best - pose)[:2]) < 0.2  # a cell of the image
    assert abs(wrap(best[2] - pose[2])) < 0.02
    other = extract_features(corners(rng))
    proposed = propose_poses(old, other)
    assert all(_count_agreeing(old, other, it) < _count_agreeing(old, new, best) / 3 for it in proposed)


def _count_agreeing(old, new, pose):
    """Number of matched keypoints that a pose lays on each other."""
    a, b = match_features(old, new).T
    away = transform_points(pose, new.points[b]) - old.points[a]
    return int((np.hypot(*away.T) < 0.5).sum())


def line(length):
    """The graph of a straight way, a key scan a metre."""
    graph = KeyGraph()
    for k in range(length):
        pose = np.array([float(k), 0.0, 0.0])
        graph.extend(pose, pose, DriftModel().variances(1.0, 0.0))
    return graph


def candidates(matches):
    """Candidates from (older, newer, shift in m along the way)."""
    return [
        Constraint(older, newer, np.array([shift, 0.0, 0.0]), np.eye(3), ConstraintSource.RECOGNIZED, True)
        for older, newer, shift in matches
    ]


SET = [(100, 200, 0.0), (110, 210, 0.0), (120, 220, 0.1)]
OTHER = [(100, 205, 12.0), (110, 215, 12.0), (120, 225, 12.1)]


@pytest.mark.parametrize(
    ("matches", "expected"),
    [
        (SET, [True] * 3),
        (SET[:2], [False] * 2),  # too few
        ([*SET[:2], (120, 220, 4.0)], [False] * 3),  # they do not agree
        ([*SET, *OTHER], [False] * 6),  # which of both?
        ([*SET, (130, 230, 0.0), *OTHER[:1]], [True] * 4 + [False]),  # outvoted
        ([*SET, (400, 220, 7.0)], [True] * 3 + [False]),  # somewhere else on the way: no contradiction
    ],
)
def test_sets_of_consistent_matches_that_no_other_contradicts_are_accepted(matches, expected):
    accepted = SubmapRecognition().accept(line(500), candidates(matches))
    assert accepted.tolist() == expected


def test_what_speaks_for_two_places_supports_neither():
    """In a row of equal rooms a match agrees with ambiguous ones, and lies too far on for their rivals to reach it."""
    other = [(130, 205, 0.0), (140, 215, 0.0), (150, 225, 0.0)]
    accepted = SubmapRecognition().accept(line(500), candidates([*SET, *other, (185, 260, 0.0)]))
    assert not accepted.any()


def test_across_a_gap_any_other_place_lets_a_set_wait():
    """One match elsewhere is too few to be a rival, but across a gap drift does not exclude that the place repeats."""
    graph = line(500)
    contradicted = candidates([*SET, (130, 230, 0.0), OTHER[0]])
    assert SubmapRecognition().accept(graph, contradicted).tolist() == [True] * 4 + [False]
    graph.variances[150] = (4.0, 0.1)
    graph.correct(np.array(graph.poses))
    assert SubmapRecognition().accept(graph, candidates(SET)).all()
    assert SubmapRecognition().accept(graph, contradicted).tolist() == [False] * 5


def test_none_is_rejected_for_want_of_what_supports_it_but_is_older():
    """What was accepted stays where a match comes so much later that only part of its set is looked at."""
    state = LoopClosureState(graph=line(500))
    state.search.candidates = candidates(SET)
    assert SubmapRecognition().decide(state) == (state.search.candidates, [])
    state.search.candidates = candidates([*SET, (400, 335, 7.0)])
    _, rejected = SubmapRecognition().decide(state)
    assert [it.pair for it in rejected] == [(400, 335)]
