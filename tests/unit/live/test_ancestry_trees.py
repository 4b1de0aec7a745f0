"""Pasts, told as a path and a tree, are those of the ancestry, thinned and rooted."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.live.ancestry_tree import thin_tree
from gridslam.particles.ancestry import Ancestry

N = 5


def record_of(steps, seed, share=0.4):
    """A run of N particles, resampled now and then."""
    rng = np.random.default_rng(seed)
    resampled = rng.random(steps) < share
    parents = np.where(resampled[:, None], np.sort(rng.integers(0, N, (steps, N)), axis=1), np.arange(N))
    poses = rng.integers(-999, 999, (steps, N, 3)).astype(np.float32) / 64  # which rounding leaves as they are
    return SimpleNamespace(poses=poses, parents=parents)


def past_of(record, particle, key):
    """The past (T, 2) of a particle as it was before the resampling at a key scan."""
    places = []
    for step in range(key, -1, -1):
        places.append(record.poses[step, particle, :2])
        particle = record.parents[step - 1, particle] if step else -1
    return np.array(places[::-1])


def walked(tree, particle, stem):
    at, places = tree.leaves[particle], []
    while at >= 0:
        places.append(tree.positions[at])
        at = tree.parents[at]
    places = np.array(places[::-1], np.float32).reshape(-1, 2)
    return np.concatenate([stem, places]) if at == -1 else places


def ancestry_of(record, key):
    ancestry = Ancestry.start(record.poses[0])
    for step in range(key):
        ancestry.resample(record.parents[step])
        ancestry.extend(record.poses[step + 1])
    return ancestry


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.2, 0.6]))
def test_path_and_tree_are_the_pasts(steps, seed, share):
    record = record_of(steps, seed, share)
    ancestry = ancestry_of(record, steps - 1)
    trunk, tree = thin_tree(ancestry)
    for particle in range(N):
        expected = past_of(record, particle, steps - 1)
        assert np.array_equal(walked(tree, particle, trunk), expected)
