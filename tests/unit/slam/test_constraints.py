"""Ties made of matches: what they weigh, what they leave open, and that they survive as arrays."""

import math

import numpy as np
import pytest

from gridslam.geometry.se2 import between
from gridslam.slam.loop_closure.constraints import (
    Constraint,
    ConstraintSource,
)
from gridslam.types import Match

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
