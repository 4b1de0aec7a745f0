"""The pruned tree equals brute force, which stores every particle's whole past."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridslam.particles import Ancestry, Multinomial
from support.ancestry_size import size


class StoredPasts:
    """Each particle's whole past as node numbers; a node's pose is looked up by its number."""

    def __init__(self) -> None:
        self.poses: list[np.ndarray] = []
        self.pasts: list[list[int]] = []

    def extend(self, poses: np.ndarray) -> None:
        self.pasts = self.pasts or [[] for _ in poses]
        self.pasts = [[*past, len(self.poses) + i] for i, past in enumerate(self.pasts)]
        self.poses.extend(poses)

    def resample(self, parents: list[int]) -> None:
        self.pasts = [self.pasts[parent] for parent in parents]

    def retract(self) -> np.ndarray:
        self.pasts = [past[:-1] for past in self.pasts]
        return self.trajectories()[:, -1]

    def trajectories(self) -> np.ndarray:
        return np.array([[self.poses[node] for node in past] for past in self.pasts])

    def common_steps(self) -> int:
        steps = list(zip(*self.pasts, strict=True))
        return next((t for t, nodes in enumerate(steps) if len(set(nodes)) > 1), len(steps))

    def node_count(self) -> int:
        return len({node for past in self.pasts for node in past})


def assert_equal(ancestry: Ancestry, stored: StoredPasts) -> None:
    assert len(ancestry) == len(stored.pasts)
    assert ancestry.steps == len(stored.pasts[0])
    assert size(ancestry) == (stored.common_steps(), stored.node_count())
    for i, want in enumerate(stored.trajectories()):
        np.testing.assert_array_equal(ancestry.trajectory(i), want)


def poses_for(count: int, number: int) -> np.ndarray:
    """Poses that no other step has."""
    return number + np.arange(3.0 * count).reshape(count, 3) / 1000


@given(st.integers(1, 6), st.data())
def test_any_sequence_of_steps_equals_brute_force(count: int, data: st.DataObject) -> None:
    stored = StoredPasts()
    stored.extend(poses_for(count, 0))
    ancestry = Ancestry.start(poses_for(count, 0))
    kept: list[tuple[Ancestry, dict[str, np.ndarray]]] = []
    for number in range(1, data.draw(st.integers(1, 25))):
        action = data.draw(st.sampled_from(["extend", "extend", "resample", "resize", "retract", "snapshot", "save"]))
        if action == "extend":
            ancestry.extend(poses_for(len(ancestry), number))
            stored.extend(poses_for(len(ancestry), number))
        elif action in ("resample", "resize"):
            size = len(ancestry) if action == "resample" else data.draw(st.integers(1, 6))
            parents = data.draw(st.lists(st.integers(0, len(ancestry) - 1), min_size=size, max_size=size))
            ancestry.resample(np.array(parents))
            stored.resample(parents)
        elif action == "retract":
            if ancestry.steps > 1:
                np.testing.assert_array_equal(ancestry.retract(), stored.retract())
        elif action == "snapshot":
            kept.append((ancestry.snapshot(), ancestry.to_arrays()))
            if data.draw(st.booleans()):  # go on with the copy: the original must not feel it either
                kept[-1], ancestry = (ancestry, kept[-1][1]), kept[-1][0]
        else:
            ancestry = Ancestry.from_arrays(ancestry.to_arrays())
        if data.draw(st.booleans()):  # who looks has dead nodes dropped
            assert_equal(ancestry, stored)
    assert_equal(ancestry, stored)
    for snapshot, arrays in kept:
        for name, array in snapshot.to_arrays().items():
            np.testing.assert_array_equal(array, arrays[name])


def test_memory_stays_bounded_however_long_the_run() -> None:
    # Multinomial resampling of N equal particles is the Wright-Fisher model: two lineages stay apart for t steps with
    # probability (1 - 1/N)^t, so all N have a common ancestor within 20 N steps but for a chance of 3 exp(-20) a step,
    # 2e-5 in 3000. There are then at most N * 20 N nodes besides the trunk, twice as many before the dead ones are
    # dropped, where brute force keeps 60000.
    count, steps = 20, 3000
    rng = np.random.default_rng(5)
    stored = StoredPasts()
    stored.extend(poses_for(count, 0))
    ancestry = Ancestry.start(poses_for(count, 0))
    most = 0
    for number in range(1, steps):
        parents = Multinomial()(np.ones(count), count, rng)
        ancestry.resample(parents)
        ancestry.extend(poses_for(count, number))
        stored.resample(parents.tolist())
        stored.extend(poses_for(count, number))
        most = max(most, int(ancestry.to_arrays()["counts"].sum()))
    assert most <= 2 * count * 20 * count
    assert ancestry.steps == steps
    assert_equal(ancestry, stored)
