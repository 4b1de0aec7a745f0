"""Which key scans the final refinement matches to which submaps."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.slam.full_slam.key_scan_matching import _nearby_key_scans
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, KeyGraph
from gridslam.slam.loop_closure.state import LoopClosureState


def wandering(rng, keys=157, frozen=0, gap=None, joined=False):
    """A walk that meets its own way again and again; with a gap in the laser data before key scan `gap`.

    A recognized place may have `joined` the way before the gap with that after it.
    """
    poses = np.column_stack([np.cumsum(rng.normal(scale=0.6, size=(keys, 2)), axis=0), rng.uniform(-3, 3, keys)])
    graph = KeyGraph(frozen=frozen)
    for key, pose in enumerate(poses):
        graph.extend(pose, pose, (4.0 if key == gap else 1e-4, 1e-6))
    if joined:
        seen = between(poses[0], poses[-1])
        graph.add(Constraint(0, keys - 1, seen, np.eye(3), ConstraintSource.RECOGNIZED, True))
    return LoopClosureState(graph=graph), poses


def expected(graph, poses):
    """By comparing everything with everything."""
    labels = graph.label_rigid_components()
    stretches = graph.label_gaps()
    wanted = [[] for _ in range(graph.complete_submaps)]
    for key, (x, y, theta) in enumerate(poses):
        away = {}
        for submap in range(graph.complete_submaps):
            begin = submap * KEY_SCANS_PER_SUBMAP
            anchor = begin + KEY_SCANS_PER_SUBMAP // 2
            is_recent = abs(submap - key // KEY_SCANS_PER_SUBMAP) <= 3 and stretches[anchor] == stretches[key]
            if is_recent or max(key, anchor) < graph.frozen:
                continue
            for other in range(begin, begin + KEY_SCANS_PER_SUBMAP):
                metres = np.hypot(poses[other][0] - x, poses[other][1] - y)
                if metres <= 3.0 and labels[other] == labels[key] and stretches[other] == stretches[anchor]:
                    distance = metres + 0.5 * abs(float(wrap(poses[other][2] - theta)))
                    away[submap] = min(away.get(submap, np.inf), distance)
        for submap in sorted(away, key=lambda submap: away[submap])[:3]:
            wanted[submap].append(key)
    return wanted


@pytest.mark.parametrize(
    ("frozen", "gap", "joined"),
    [(0, None, False), (60, None, False), (0, 85, False), (47, 85, False), (0, 85, True)],
)
@pytest.mark.parametrize("seed", range(3))
def test_key_scans_are_matched_to_the_nearest_submaps_of_other_times(seed, frozen, gap, joined):
    closure_state, poses = wandering(np.random.default_rng(seed), frozen=frozen, gap=gap, joined=joined)
    wanted = _nearby_key_scans(closure_state, poses)
    assert wanted == expected(closure_state.graph, poses)
    assert sum(map(len, wanted)) > 20
