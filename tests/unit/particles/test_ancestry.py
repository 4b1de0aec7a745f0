"""Ancestry: a worked tree, the saved form and refusals; `tests/laws` compares it with brute force."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.particles import Ancestry
from support.ancestry_size import size


def row(*xs: float) -> np.ndarray:
    return np.array([[x, 0.0, 0.0] for x in xs])


def pasts(ancestry: Ancestry) -> np.ndarray:
    """Poses (N, T, 3) of all particles."""
    return np.stack([ancestry.trajectory(particle) for particle in range(len(ancestry))])


def two_branches() -> Ancestry:
    """Three particles: step 0 at 0, 1, 2; the last two go on from 1, the first from 0."""
    ancestry = Ancestry.start(row(0, 1, 2))
    ancestry.resample([0, 1, 1])
    ancestry.extend(row(10, 11, 12))
    return ancestry


def test_a_worked_tree() -> None:
    ancestry = two_branches()
    assert (len(ancestry), ancestry.steps, *size(ancestry)) == (3, 2, 0, 5)
    np.testing.assert_array_equal(pasts(ancestry)[:, :, 0], [[0, 10], [1, 11], [1, 12]])
    ancestry.resample([2, 1, 2])
    assert size(ancestry) == (1, 3)
    np.testing.assert_array_equal(pasts(ancestry)[:, :, 0], [[1, 12], [1, 11], [1, 12]])
    ancestry.resample([1, 1, 1])
    assert size(ancestry) == (2, 2)
    np.testing.assert_array_equal(ancestry.trajectory(2)[:, 0], [1, 11])


@pytest.mark.parametrize("parents", [[], [0, 1, 3], [-1, 0, 0], [0.0, 1.0], [[0, 1]], [True, False, True]])
def test_resample_refuses_what_is_no_parent(parents: list[object]) -> None:
    ancestry = two_branches()
    with pytest.raises(ArgumentError, match="parents"):
        ancestry.resample(parents)
    assert size(ancestry)[1] == 5


@pytest.mark.parametrize(
    ("name", "bad"),
    [
        ("trunk", np.zeros((0, 2))),
        ("counts", np.array([2, 2])),
        ("counts", np.array([5, 0])),
        ("poses", np.zeros((4, 3))),
        ("poses", np.zeros((5, 3), dtype=np.float32)),
        ("parents", np.array([0, 0, 0, 1, 2])),
        ("parents", np.array([0, 0, 0, 0, 0])),
        ("parents", np.array([0, 0, -1, 0, 1])),
        ("parents", np.array([0, 1, 0, 1, 1])),
        ("leaves", np.array([0, 1])),
        ("leaves", np.array([0, 1, 3])),
        ("leaves", np.empty(0, dtype=np.int64)),
    ],
)
def test_a_damaged_state_is_refused(name: str, bad: np.ndarray) -> None:
    with pytest.raises(ArgumentError, match=r"trunk|counts|poses|parents|leaves"):
        Ancestry.from_arrays(two_branches().to_arrays() | {name: bad})


def test_an_incomplete_state_is_refused() -> None:
    arrays = two_branches().to_arrays()
    del arrays["leaves"]
    with pytest.raises(ArgumentError, match="leaves"):
        Ancestry.from_arrays(arrays)
    nothing = {"trunk": np.empty((0, 3)), "counts": np.empty(0, dtype=np.int64), "poses": np.empty((0, 3))}
    with pytest.raises(ArgumentError, match="step"):
        Ancestry.from_arrays(nothing | {"parents": np.empty(0, np.int64), "leaves": np.zeros(2, np.int64)})


def test_all_particles_along_one_past() -> None:
    """As if all had been one particle from the start; what they do next is their own."""
    past = np.random.default_rng(0).normal(size=(7, 3))
    ancestry = Ancestry.from_trajectory(past, 4)
    given, past[:] = past.copy(), 9.0
    assert (len(ancestry), ancestry.steps, *size(ancestry)) == (4, 7, 7, 7)
    lone = Ancestry.start(given[:1])
    for pose in given[1:]:
        lone.extend(pose[None])
    lone.resample([0, 0, 0, 0])
    new = np.arange(12.0).reshape(4, 3)
    for one in (ancestry, lone):
        np.testing.assert_array_equal(pasts(one), np.repeat(given[None], 4, axis=0))
        one.extend(new)
        one.resample([3, 1, 1, 0])
        np.testing.assert_array_equal(pasts(one)[:, :-1], np.repeat(given[None], 4, axis=0))
        np.testing.assert_array_equal(pasts(one)[:, -1], new[[3, 1, 1, 0]])
    for name, array in ancestry.to_arrays().items():
        np.testing.assert_array_equal(array, lone.to_arrays()[name], err_msg=name)
    again = Ancestry.from_arrays(ancestry.to_arrays())
    np.testing.assert_array_equal(pasts(again), pasts(ancestry))
