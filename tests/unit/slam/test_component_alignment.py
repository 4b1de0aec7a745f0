"""A piece of the drive after a blind stretch is laid where all of it fits, and nowhere if that is not certain."""

from functools import partial

import numpy as np
import pytest

from closure_worlds import deceptive
from gridslam.geometry.se2 import between, compose
from gridslam.slam.full_slam import component_alignment
from gridslam.slam.full_slam.component_alignment import (
    Alignment,
    Hypothesis,
    KnownMap,
    SearchHit,
    align_components,
    propose_alignments,
)
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.place_matching import PlaceMatching
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submaps import build_map
from support import hall

LAP = 95
"""Key scans of a lap in the hall."""
BLIND = np.array([1.2, -0.8, 0.25])
"""By how much odometry is wrong where the robot goes on blindly."""


@pytest.fixture(scope="module")
def seen():
    return hall.key_scans(hall.drive(1))


def interrupted(seen, at, *, wrong=BLIND, until=None):
    """Remember a drive whose increment to key scan `at` is wrong, and known to be uncertain."""
    closure_state, poses = LoopClosureState(), [seen.truth[0]]
    for k, increment in enumerate(between(seen.truth[:-1], seen.truth[1:]), start=1):
        poses.append(compose(poses[-1], compose(increment, wrong) if k == at else increment))
    for k, pose in enumerate(poses[:until]):
        closure_state.scans.append(seen.beams[k], pose, is_key=True)
        closure_state.graph.extend(pose, pose, (1.5**2, 0.3**2) if k == at else DriftModel().variances(0.4, 0.1))
    return closure_state


def aligned(closure_state):
    return align_components(closure_state, hall.MAPPER, SubmapPairs(), PlaceMatching(), lambda: None)


def proposed(closure_state):
    return propose_alignments(closure_state, hall.MAPPER, SubmapPairs(), LoopClosure(), lambda: None)


def test_a_component_is_laid_where_its_key_scans_fit(seen):
    constraints = aligned(interrupted(seen, LAP + 5))
    assert len(constraints) >= 10
    assert all(
        constraint.from_ < LAP + 5 <= constraint.to
        and constraint.source is ConstraintSource.RECOGNIZED
        and constraint.determined
        for constraint in constraints
    )
    assert (hall.errors(seen.truth, constraints) < [0.1, 0.02]).all()


def test_what_is_too_little_to_be_aligned_is_proposed(seen, monkeypatch):
    closure_state = interrupted(seen, LAP + 5)
    monkeypatch.setattr(component_alignment, "Alignment", partial(Alignment, min_log_likelihood=1e4))
    assert aligned(closure_state) == []
    (place,) = proposed(closure_state)
    assert place.from_ < LAP + 5 <= place.to
    assert (hall.errors(seen.truth, [place]) < [0.1, 0.02]).all()
    assert proposed(interrupted(seen, LAP + 5, until=LAP + 5)) == [], "without a gap there is one component"


@pytest.mark.parametrize(("kind", "seed"), [("symmetric", 2)])
def test_where_places_are_alike_nothing_false_is_aligned(kind, seed):
    """The second half of the drive hangs on a blind stretch; a shift by a room would fit nearly as well."""
    seen = hall.key_scans(deceptive(kind, seed).simulate())
    closure_state = interrupted(seen, len(seen.truth) // 2)
    assert (hall.errors(seen.truth, aligned(closure_state)).reshape(-1, 2) < [0.5, 0.09]).all()


def test_a_rival_that_says_as_much_refutes(seen, monkeypatch):
    """The same beams stand in the map twice, 12 m apart: which of the two the piece shows cannot be told."""
    half = 40
    truth = seen.truth[:half]
    shifted = truth + np.array([12.0, 12.0, 0.0])
    twice = np.concatenate([truth, shifted, truth])
    closure_state, beams = LoopClosureState(), [*seen.beams[:half]] * 3
    for k, pose in enumerate(twice):
        closure_state.scans.append(beams[k], pose, is_key=True)
        closure_state.graph.extend(pose, pose, (6.0**2, 0.3**2) if k == 2 * half else DriftModel().variances(0.4, 0.1))
    assert aligned(closure_state) == []
    monkeypatch.setattr(component_alignment, "Alignment", partial(Alignment, ambiguity_ratio=2.0))
    assert len(aligned(closure_state)) >= 3
    monkeypatch.undo()
    once = interrupted(hall.Seen(np.concatenate([truth, truth]), beams[: 2 * half]), half, wrong=np.zeros(3))
    assert len(aligned(once)) >= 3


def decided(best, *, shifted, others=()):
    """Decide with every shift of the best hypothesis having the same log likelihood."""
    alignment = Alignment(LoopClosureState(), None, None, np.zeros(1, int), None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(component_alignment, "build_map", lambda *_: None)
        patch.setattr(Alignment, "_score_both", lambda *_: (shifted, 1.0, 0.9))
        return alignment.decide([best, *others])


@pytest.mark.parametrize(
    ("likelihood", "squared", "is_accepted"),
    [(10.1, 0.0, True), (9.9, 0.0, False), (30.0, 3.9, True), (30.0, 4.1, False)],
)
def test_evidence_and_drift_must_be_enough(likelihood, squared, is_accepted):
    best = Hypothesis(np.zeros((1, 3)), likelihood, squared, 1.0, 0.9)
    assert (decided(best, shifted=-1.0) is not None) == is_accepted


@pytest.mark.parametrize(("beside_m", "is_open"), [(0.2, False), (0.4, True), (1.4, True), (1.6, None)])
def test_what_fits_a_metre_beside_leaves_the_place_open_and_what_fits_elsewhere_refutes(beside_m, is_open):
    """Furniture was moved by less than a metre: the place is known, although not to a decimetre."""
    best = Hypothesis(np.zeros((1, 3)), 30.0, 0.0, 1.0, 0.9)
    found = decided(
        best, shifted=-1.0, others=[best._replace(poses=np.array([[beside_m, 0.0, 0.0]]), log_likelihood=29.0)]
    )
    assert (None if found is None else found.is_open) == is_open


def test_what_fits_at_every_shift_is_refuted():
    assert decided(Hypothesis(np.zeros((1, 3)), 30.0, 0.0, 1.0, 0.9), shifted=29.0) is None


@pytest.mark.parametrize("there_and_back", [(40.0, -10.0), (-10.0, 40.0)])
def test_the_lesser_of_both_directions_counts(monkeypatch, there_and_back):
    """A component that lies where the other one saw free space, or that sees free space where the other one lies."""
    scores = iter(there_and_back)
    monkeypatch.setattr(Alignment, "_score", lambda *_, **__: (next(scores), 1.0, 0.9))
    known = KnownMap(None, np.zeros((1, 3)), np.zeros(1, int), None)
    state = LoopClosureState()
    alignment = Alignment(state, None, None, np.zeros(1, int), known)
    assert alignment._score_both(np.zeros((1, 3)), None)[0] == -10.0


@pytest.mark.parametrize("key", [LAP + 31, 2 * LAP - 12], ids=["between", "after"])
def test_of_a_component_some_key_scans_may_be_laid_on_the_map(seen, key):
    """The hit is that of a key scan which is none of them, and its pose is not taken for that of another one."""
    closure_state = interrupted(seen, LAP + 5)
    poses = np.array(closure_state.graph.poses)
    old, few = np.arange(LAP + 5), np.arange(LAP + 5, 2 * LAP - 13, 4)
    assert key not in few
    assert few[0] < key
    known = KnownMap(closure_state.scans, poses, old, build_map(hall.MAPPER, closure_state.scans, old, poses[old]))
    alignment = Alignment(closure_state, hall.MAPPER, PlaceMatching(), few, known)
    laid = alignment.lay_component([SearchHit(key, compose(seen.truth[key], [0.1, -0.1, 0.01]), 0.9)])
    assert np.hypot(*between(seen.truth[few], laid.poses)[:, :2].T).max() < 0.1
