"""Hypotheses about where a rigid component lies in the map of another one, from single key scans found there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.types import FloatArray

__all__ = ["AlignmentHypothesis", "SearchHit", "group_hits"]


_CONSISTENT_M, _CONSISTENT_M_PER_KEY_SCAN, _CONSISTENT_RAD = 0.3, 0.01, 0.06
"""Hits are consistent if the tracked motion leads from one to the other this closely."""


@final
@dataclass(frozen=True, slots=True)
class SearchHit:
    """Pose (3,) at which a search found a key scan in the map of another component.

    `score` is that of the search, `plausible` whether the drift permits the pose, `distinct` whether no other pose
    scored nearly as high.
    """

    key: int
    pose: FloatArray
    score: float
    plausible: bool
    distinct: bool


@final
@dataclass(frozen=True, slots=True)
class AlignmentHypothesis:
    """A component tracked through the map of another one from the best of the hits that agree.

    `poses` (K, 3) are those of all its key scans, `log_likelihood` is theirs; `distinct_hits` had no other place that
    fits nearly as well.
    """

    poses: FloatArray
    log_likelihood: float
    plausible: bool
    distinct_hits: int

    def distance_m(self, other: AlignmentHypothesis) -> float:
        """Median distance of the key scans from where another hypothesis has them."""
        return float(np.median(np.hypot(*(self.poses - other.poses)[:, :2].T)))


def group_hits(graph: KeyGraph, hits: list[SearchHit]) -> list[list[SearchHit]]:
    """Group hits that are consistent with the tracked motion."""
    groups: list[list[SearchHit]] = []
    for hit in hits:
        for group in groups:
            last = group[-1]
            moved = between(graph.tracked[last.key], graph.tracked[hit.key])
            x, y, turn = between(compose(last.pose, moved), hit.pose).tolist()
            reach_m = _CONSISTENT_M + _CONSISTENT_M_PER_KEY_SCAN * (hit.key - last.key)
            if np.hypot(x, y) < reach_m and abs(turn) < _CONSISTENT_RAD:
                group.append(hit)
                break
        else:
            groups.append([hit])
    return groups
