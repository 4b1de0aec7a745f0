"""Revisits by the last metres of a drive, which the drift alone all but determines."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.full_slam.component_alignment import (
    LENGTH_M,
    MARGIN_M,
    SEARCH_SIGMAS,
    STEP_M,
    Alignment,
    KnownMap,
    WantedSearch,
    group_hits,
)
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.key_graph import KeyGraph, position_sigmas
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.map_search import MapSearch
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submap_matching import Submap
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submaps import build_map
from gridslam.types import IntArray

_MAX_SIGMA_M = 1.5
"""Standard deviation of the relative position up to which the drift leaves hardly more than one place: rooms that look
alike are farther from each other than two of these."""
_MAX_HYPOTHESES = 4
"""Places of a stretch that are compared."""


def propose_revisits(
    closure_state: LoopClosureState,
    mapper: OccupancyGridMapping,
    stretches: SubmapPairs,
    closure: LoopClosure,
    on_progress: Callable[[], None],
    searched: int = 0,
) -> list[Constraint]:
    """Propose revisits: short stretches at the end of the way that fit the map of a much earlier part.

    Recognition needs several matches that agree, tens of metres of way; a drive that ends where it came from has a few
    metres of it. Where the drift leaves hardly another place, such a stretch is searched for in the map of older key
    scans. It may be wrong all the same: a trajectory with what is proposed must have the better score.

    Parameters
    ----------
    closure_state
        Key scans, and the graph with the poses of which the map is drawn; it predicts where each stretch lies, too.
    mapper
        How the map is drawn.
    stretches
        Short submaps, cut so far; modified.
    closure
        Place recognition.
    on_progress
        Called once for each stretch.
    searched
        Number of first key scans of which no stretch is searched for.
    """
    graph, scans = closure_state.graph, closure_state.scans
    stretches.cut(graph, scans, mapper, LENGTH_M, STEP_M, is_over=True)
    poses, way = np.array(graph.poses), graph.driven_m()
    # before the last submap of way recognition has enough of it
    first = max(searched, int(way.searchsorted(way[-1] - closure.recognition.length_m)))
    wanted = _select_searches(graph, [it for it in stretches.submaps if it.anchor >= first], closure)
    if not wanted:
        return []
    searches, older = zip(*wanted, strict=True)
    keys = np.unique(np.concatenate(older))  # one map for all of them
    keys = keys[way[searches[0].submap.anchor] - way[keys] > closure.recognition.apart_m]
    known = KnownMap(scans, poses, keys, build_map(mapper, scans, keys, poses[keys]))
    map_search = MapSearch(known.maps)
    found: list[Constraint] = []
    for search in searches:
        on_progress()
        alignment = Alignment(closure_state, mapper, closure.places, search.submap.keys, known)
        groups = group_hits(graph, search.run(graph, map_search))[:_MAX_HYPOTHESES]
        best = max(map(alignment.lay_component, groups), key=lambda it: it.evidence, default=None)
        if best is not None and not alignment.is_left_open(best):
            found += alignment.constrain_as_one(best)
    return found


def _select_searches(
    graph: KeyGraph, submaps: list[Submap], closure: LoopClosure
) -> list[tuple[WantedSearch, IntArray]]:
    """Select stretches that are expected where older key scans (K,) were that no constraint joins them with."""
    way = graph.driven_m()
    labels = graph.label_rigid_components()
    wanted = []
    for submap in submaps:
        key = submap.anchor
        older = np.flatnonzero((way[key] - way > closure.recognition.apart_m) & (labels == labels[key]))
        if not len(older):
            continue
        expected, covariances = graph.locate(key, older)
        sigmas_m = position_sigmas(covariances)
        reach_m = SEARCH_SIGMAS * sigmas_m + MARGIN_M
        is_near = np.hypot(*expected[:, :2].T) < reach_m + submap.radius_m
        is_near &= (sigmas_m >= closure.recognition.certain_sigma_m) & (sigmas_m < _MAX_SIGMA_M)
        if not is_near.any():
            continue
        best = int(np.where(is_near, sigmas_m, np.inf).argmin())
        wanted.append((WantedSearch(submap, 0, int(older[best]), expected[best], covariances[best]), older[is_near]))
    return wanted
