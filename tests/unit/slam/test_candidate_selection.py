"""Candidates are compared by one score, and what is told of the best belongs together."""

import numpy as np
import pytest

from gridslam.mapping import OccupancyGridMapping
from gridslam.slam.full_slam.global_scan_refinement import Candidate, CandidateSelection, _Refinement
from gridslam.slam.full_slam.trajectory_score import TrajectoryScore
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.pose_graph.pose_graph import PoseGraph

MAPPER = OccupancyGridMapping()


def candidate(name, height, constraints=(), weights=None):
    """Two poses, a metre apart, at a height that tells the score which one it is."""
    poses = np.array([[0.0, height, 0.0], [1.0, height, 0.0]])
    chain = np.array([[0, 1], *((t.from_, t.to) for t in constraints)])
    told = np.array([[1.0, 0.0, 0.0], *(t.measurement for t in constraints)])
    graph = PoseGraph(poses, chain, told, np.tile(np.eye(3), (len(chain), 1, 1)), np.arange(len(chain)) < 1)
    return Candidate(name, graph, list(constraints), np.ones(len(chain)) if weights is None else np.array(weights))


class Judge:
    """Gives the log likelihoods it is told to, and a map of its own with each."""

    def __init__(self, likelihoods):
        self.likelihoods, self.maps, self.poses = list(likelihoods), [], []

    def __call__(self, poses):
        self.maps.append(MAPPER.empty(1))
        self.poses.append(poses)
        return TrajectoryScore(self.likelihoods[len(self.poses) - 1], 100, 0.8, -1.0), self.maps[-1]


def selection(likelihoods):
    judge = Judge(likelihoods)
    all_ = [candidate(f"closed {k}", float(k)) for k in range(len(likelihoods))]
    held = CandidateSelection(judge, all_[0])
    told = [likelihoods[0], *(held.add(one) for one in all_[1:])]
    return held, judge, all_, told


@pytest.mark.parametrize(
    ("likelihoods", "best"),
    [
        ([-5.0], 0),
        ([-5.0, -4.0], 1),
        ([-4.0, -5.0], 0),
        ([-4.0, -4.0], 0),
        ([-6.0, -4.0, -4.0, -5.0], 1),
        ([-6.0, -4.0, -5.0, -3.0], 3),
        ([0.0, -0.0, -1e-9], 0),
    ],
)
def test_the_best_is_the_first_of_those_that_no_other_exceeds(likelihoods, best):
    held, judge, all_, _ = selection(likelihoods)
    assert held.best is all_[best]
    assert held.maps is judge.maps[best]


def test_adjusted_poses_are_the_answer_though_they_score_less():
    held, judge, all_, _ = selection([-5.0, -4.0, -6.0])
    judge.likelihoods.append(-40.0)
    moved = all_[1].graph.poses + 0.01
    held.adjust_best(moved)
    assert held.best.name == "closed 1"
    np.testing.assert_array_equal(held.best.graph.poses, moved)
    assert held.maps is judge.maps[3]
    assert held.scores["adjusted"].log_likelihood == -40.0
    assert held.scores["closed 1"].log_likelihood == -4.0


def test_accepted_constraints_are_those_of_the_last_weights_and_recognized_ones_those_searched_for():
    constraints = [
        Constraint(0, 1, np.array([1.0, 0.0, 0.0]), np.eye(3), source, True)
        for source in (
            ConstraintSource.RECOGNIZED,
            ConstraintSource.TRACKED,
            ConstraintSource.PROXIMITY,
            ConstraintSource.RECOGNIZED,
        )
    ]
    one = candidate("refined", 0.0, constraints, [0.0, 0.9, 0.49, 0.5, 0.0])
    assert one.recognized_constraints == [constraints[0], constraints[3]]
    assert one.accepted_constraints == [constraints[0], constraints[2]]
    assert candidate("filter", 0.0, weights=[0.0]).accepted_constraints == []


@pytest.mark.parametrize(("likelihood", "searches"), [(-6.0, 1), (-4.0, 3)])
def test_a_search_follows_one_that_was_better(monkeypatch, likelihood, searches):
    """The best candidate takes over the places that agree with it, which is no reason to search again."""
    places = [Constraint(0, 1, np.array([x, 0, 0]), np.eye(3), ConstraintSource.RECOGNIZED, True) for x in (1, 1, 50)]
    likelihoods = [-5.0, *(likelihood + k for k in range(3))]
    held = CandidateSelection(Judge(likelihoods), candidate("filter", 0.0))
    names, kept = [], []

    def add_closures(_, name, begin):
        names.append(name)
        return candidate(name, 0.0, places)

    def keep_trajectory(_, name, poses, recognized):
        kept.append(recognized)
        return candidate(name, 0.0, recognized)

    monkeypatch.setattr(_Refinement, "_add_closures", add_closures)
    monkeypatch.setattr(_Refinement, "_keep_trajectory", keep_trajectory)
    state = LoopClosureState()
    for _ in range(2):
        state.graph.extend(np.zeros(3), np.zeros(3), (1e-4, 1e-4))
    pairs = SubmapPairs()
    refinement = _Refinement(state, MAPPER, LoopClosure(), lambda: None, [], 0, [], pairs, pairs)
    refinement._close_loops(held)
    assert len(names) == searches
    assert kept == ([places[:2]] if searches == 1 else [])
    assert state.rejected[RejectionReason.IMPLAUSIBLE] == len(kept)
