"""Pasts, told as a path and a tree, are those of the ancestry: thinned, rooted, and at any time of a record."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.io.results.record import Record, RecordFlag
from gridslam.live.ancestry_tree import full_tree, thin_tree
from gridslam.live.results import AncestryReplay
from gridslam.particles.ancestry import Ancestry

N = 5


def record_of(steps, seed, share=0.4):
    """A run of N particles, resampled now and then."""
    rng = np.random.default_rng(seed)
    resampled = rng.random(steps) < share
    parents = np.where(resampled[:, None], np.sort(rng.integers(0, N, (steps, N)), axis=1), np.arange(N))
    poses = rng.integers(-999, 999, (steps, N, 3)).astype(np.float32) / 64  # which rounding leaves as they are
    return Record(
        stamps_ns=np.arange(steps, dtype=np.int64),
        poses=poses,
        log_weights=np.full((steps, N), -np.log(N)),
        parents=parents.astype(np.int32),
        best=np.zeros(steps, np.int32),
        n_eff=np.ones(steps),
        flags=(resampled * RecordFlag.RESAMPLED).astype(np.uint8),
        latency_s=np.ones(steps),
    )


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
        assert np.array_equal(walked(full_tree(ancestry), particle, trunk[:0]), expected)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 150), st.lists(st.integers(0, 149), min_size=1, max_size=12), st.integers(0, 2**32 - 1))
def test_pasts_at_any_time_in_any_order(steps, keys, seed):
    record = record_of(steps, seed)
    pasts = AncestryReplay(record)
    for key in (min(key, steps - 1) for key in keys):
        ancestry = pasts.at(key)
        assert ancestry.steps == key + 1
        for particle in range(N):
            assert np.array_equal(ancestry.trajectory(particle)[:, :2], past_of(record, particle, key))
