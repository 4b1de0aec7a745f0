"""The paths of all particles as one tree, thinned for the page."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from gridslam.particles.ancestry import Ancestry
from gridslam.types import IntArray

Float32Array: TypeAlias = NDArray[np.float32]

_MAX_NODES = 1500  # of a tree; of larger trees fewer steps are kept
_STEPS_PER_UNIT = np.float32(64)  # per m: positions are rounded to 1.6 cm, which halves their compressed size
NO_POINTS: Float32Array = np.zeros((0, 2), np.float32)


@final
class AncestryTree(NamedTuple):
    """The part of the particles' paths that they do not share.

    Attributes
    ----------
    positions : (M, 2) float32
        Positions of the nodes, to 1.6 cm.
    parents : (M,) int32
        Parent of each node; -1: the end of the shared path, -2: none.
    leaves : (N,) int32
        Node of each particle; -1: the end of the shared path.
    """

    positions: Float32Array
    parents: NDArray[np.int32]
    leaves: NDArray[np.int32]


NO_TREE = AncestryTree(NO_POINTS, np.zeros(0, np.int32), np.zeros(0, np.int32))
"""The tree of particles without ancestry."""


def thin_tree(ancestry: Ancestry, max_nodes: int = _MAX_NODES) -> tuple[Float32Array, AncestryTree]:
    """Return the path (T, 2) that all particles share, and the tree after it, thinned to about `max_nodes`."""
    arrays = ancestry.to_arrays()
    counts = arrays["counts"]
    parents = arrays["parents"]
    leaves = arrays["leaves"]
    trunk = arrays["trunk"][:, :2].astype(np.float32)
    begins = np.concatenate([[0], np.cumsum(counts)])
    kept = _select_steps(counts, max_nodes)
    nodes = np.concatenate([np.arange(begins[k], begins[k + 1]) for k in kept] or [leaves[:0]])
    number = np.full(len(parents), -1, np.int64)  # of each kept node among those that are kept
    number[nodes] = np.arange(len(nodes))
    before = np.full(len(parents), -1, np.int64)
    for earlier, level in pairwise(kept):
        above = parents[begins[level] : begins[level + 1]]
        for between in range(level - 1, earlier, -1):
            above = parents[begins[between] : begins[between + 1]][above]
        before[begins[level] : begins[level + 1]] = number[begins[earlier] + above]
    ends = number[begins[-2] + leaves] if len(counts) else np.full(len(leaves), -1)
    positions = arrays["poses"][nodes, :2].astype(np.float32)
    rounded = (np.rint(positions * _STEPS_PER_UNIT) / _STEPS_PER_UNIT).astype(np.float32)
    tree = AncestryTree(rounded, before[nodes].astype(np.int32), ends.astype(np.int32))
    return trunk, tree


def _select_steps(counts: IntArray, max_nodes: int) -> list[int]:
    """Select steps at even distances, the last one included, of which the nodes (T,) are at most `max_nodes`."""
    last = len(counts) - 1
    stride = 1
    while stride < last and counts[last::-stride].sum() > max_nodes:
        stride *= 2
    return list(range(last, -1, -stride))[::-1]
