"""Old places are recognized where they are unlike all others, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from closure_worlds import Drive, deceptive, returns
from gridslam.geometry.se2 import between
from gridslam.slam.loop_closure.constraints import ConstraintSource
from gridslam.slam.loop_closure.drift_model import DriftModel
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from support import hall

LAP = 95
"""Key scans of a lap in the hall."""


@pytest.fixture(scope="module")
def drives():
    return {seed: hall.key_scans(hall.drive(seed)) for seed in (1, 3)}


@pytest.mark.parametrize(("seed", "bias_rad_per_m"), [(1, 0.001), (1, 0.002), (3, -0.001), (3, 0.002)])
def test_the_way_is_recognized_when_it_is_driven_again(drives, seed, bias_rad_per_m):
    """After a lap the track is 0.25 to 2 m off; a tie is right to a cell or two."""
    seen = drives[seed]
    poses, closure_state = hall.tracked(seen.truth, bias_rad_per_m, 1.01), LoopClosureState()
    told = hall.remember(closure_state, seen, poses)
    constraints = [constraint for _, constraint in told]
    assert len(constraints) >= hall.EAGER.min_confirmations
    assert [(t.from_, t.to) for t in closure_state.graph.constraints if t.source is ConstraintSource.RECOGNIZED] == [
        (t.from_, t.to) for t in constraints
    ]
    for key, constraint in told:
        assert constraint.to <= key
        assert constraint.to - constraint.from_ > LAP / 2
        assert constraint.determined
        assert np.linalg.eigvalsh(constraint.information)[0] > 0
    as_tracked = [
        constraint._replace(measurement=between(poses[constraint.from_], poses[constraint.to]))
        for constraint in constraints
    ]
    off = hall.errors(seen.truth, as_tracked)[:, 0]
    assert (off > 0.2).all()  # four cells; else it would not have been worth the search
    assert (hall.errors(seen.truth, constraints) < [0.1, 0.02]).all()


def test_what_follows_a_recognized_place_is_known(drives):
    """The ways through it are short; no search is needed any more, and every such tie is right."""
    seen, closure_state = drives[1], LoopClosureState()
    told = hall.remember(closure_state, seen, hall.tracked(seen.truth, 0.002, 1.01))
    first = told[0][0]
    after = [constraint for constraint in hall.trusted(closure_state) if constraint.to > first]
    assert sum(constraint.source is ConstraintSource.TRACKED for constraint in after) > 5
    assert (hall.errors(seen.truth, after) < [0.15, 0.03]).all()


def test_where_the_way_back_is_certain_places_are_known_without_a_search(drives):
    """Tracked without an error, and the drift says so."""
    seen, closure_state = drives[3], LoopClosureState()
    certain = DriftModel(
        sigma_m_per_sqrt_m=0.005, sigma_rad_per_sqrt_m=0.0003, sigma_rad_per_sqrt_rad=0.001, sigma_m_per_sqrt_rad=0.002
    )
    told = hall.remember(closure_state, seen, seen.truth, drift=certain)
    assert told == []
    assert (
        sum(constraint.source is ConstraintSource.TRACKED for constraint in closure_state.graph.constraints) > LAP / 2
    )
    assert (hall.errors(seen.truth, hall.trusted(closure_state)) < [0.1, 0.02]).all()


@pytest.mark.parametrize("far_m", [2.0, 3.0, 8.0])
def test_an_old_place_out_of_reach_is_not_believed(drives, far_m):
    """The track jumps by some metres, of which the drift says nothing: what was before it fits, but not there."""
    seen, closure_state = drives[1], LoopClosureState()
    jump = np.where(np.arange(len(seen.truth)) < 60, 0.0, far_m)[:, None] * [1.0, 1.0, 0.0]
    told = hall.remember(closure_state, seen, seen.truth + jump, drift=DriftModel())
    assert told == []
    assert all(constraint.from_ // KEY_SCANS_PER_SUBMAP >= 6 for constraint in hall.trusted(closure_state))
    assert sum(closure_state.rejected.values()) > 3


def test_too_few_confirmations_are_no_recognition(drives):
    """As soon as the last of the searches that must agree has been made it is told, and not before."""
    seen = drives[1]
    poses, first = hall.tracked(seen.truth, 0.002, 1.01), []
    for confirmations in (1, 2, 3):
        recognition = replace(hall.EAGER, min_confirmations=confirmations)
        told = hall.remember(LoopClosureState(), seen, poses, recognition=recognition)
        first.append(told[0][0])
        assert len({key for key, _ in told[:confirmations]}) == 1
    assert first[0] < first[1] <= first[2]


def test_nothing_is_looked_for_while_all_is_recent(drives):
    seen, closure_state = drives[1], LoopClosureState()
    hall.remember(
        closure_state, seen, seen.truth, until=hall.EAGER.recent_submaps * KEY_SCANS_PER_SUBMAP + KEY_SCANS_PER_SUBMAP
    )
    assert closure_state.graph.constraints == []
    assert not closure_state.rejected


def test_a_scan_without_a_beam_is_passed_over(drives):
    seen = drives[1]
    blind = seen.beams[120]
    blind = replace(blind, indices=blind.indices[:0], ends=blind.ends[:0])
    beams = [blind if 115 <= k < 135 else b for k, b in enumerate(seen.beams)]
    closure_state = LoopClosureState()
    hall.remember(closure_state, hall.Seen(seen.truth, beams), hall.tracked(seen.truth, 0.001), until=150)
    assert not any(115 <= constraint.to < 135 for constraint in closure_state.graph.constraints)


def driven(world: Drive) -> hall.Seen:
    stream = world.stream()
    assert returns(stream.truth.poses) < 0.1
    return hall.key_scans(stream)


@pytest.mark.parametrize(("kind", "seed"), [("equal_rooms", 0), ("symmetric", 2), ("bare_corridors", 0)])
def test_where_places_are_alike_none_is_recognized(kind, seed):
    """Rooms, wings and corridors like others before, hardly ever the same ones; the drift would allow for them."""
    seen, closure_state = driven(deceptive(kind, seed)), LoopClosureState()
    poses = hall.tracked(seen.truth, 0.0007, 1.01)
    hall.remember(closure_state, seen, poses, drift=DriftModel(sigma_m_per_sqrt_m=0.1, sigma_rad_per_sqrt_m=0.006))
    assert (hall.errors(seen.truth, hall.trusted(closure_state)) < [0.5, 0.09]).all()
    assert not any(constraint.source is ConstraintSource.RECOGNIZED for constraint in closure_state.graph.constraints)
    assert sum(closure_state.rejected.values()) > 3
    if kind != "symmetric":
        assert (
            closure_state.rejected[RejectionReason.AMBIGUOUS] + closure_state.rejected[RejectionReason.IMPLAUSIBLE] > 0
        )


def test_a_bare_corridor_driven_twice_has_no_place_along_it():
    """Ties across it may be made, but none that says where along it the robot is."""
    seen = driven(deceptive("bare_corridors", 0))
    once = next(k for k, pose in enumerate(seen.truth) if np.hypot(*pose[:2]) > 30)
    there = seen.truth[:once]
    assert abs(there[-1, 2]) < 0.2  # straight on
    beams, closure_state = list(seen.beams[:once]), LoopClosureState()
    again = hall.Seen(np.concatenate([there, there[::-1], there]), [*beams, *beams[::-1], *beams])
    hall.remember(
        closure_state,
        again,
        hall.tracked(again.truth, 0.0005, 1.01),
        drift=DriftModel(sigma_m_per_sqrt_m=0.1, sigma_rad_per_sqrt_m=0.006),
    )
    assert not any(constraint.source is ConstraintSource.RECOGNIZED for constraint in closure_state.graph.constraints)
