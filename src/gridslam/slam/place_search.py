"""Searching for a key scan in the old submaps where the robot may be, and in all that it must be told from."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import between, compose
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import LatticeMatch, thin_points
from gridslam.slam import place_evidence as evidence
from gridslam.slam.key_graph import BLOCK, KeyGraph, Nearby
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.place_parameters import PlaceParameters
from gridslam.slam.submaps import anchor_of
from gridslam.slam.ties import Source, Tie
from gridslam.types import FloatArray

__all__ = ["candidate_pieces", "search_place"]

_FEW, _MOST_SUBMAPS = 12, 24
"""Submaps in which a place is searched for, and those from which it must be told."""


def search_place(
    places: PlaceParameters, memory: Memory, mapper: OccupancyGridMapping, key: int, candidates: list[Nearby]
) -> Tie | Rejection | None:
    """Search what was seen up to a key scan in old submaps where the robot may have been: one of `candidate_pieces`.

    Where the map to search in has to be drawn first, that is all for now, and None is returned: no scan shall wait for
    both.
    """
    graph, oldest = memory.graph, key // BLOCK - places.gap
    way, blocks = candidates[0], tuple(n.block for n in candidates)
    guess = compose(graph.poses[way.block * BLOCK], way.pose)
    points = thin_points(evidence.recent_points(memory, key, places.query), places.search.max_points)
    if set(blocks[:_FEW]) <= set(memory.wide):
        found = _told_apart(places, memory, mapper, key, guess, way.covariance, points)
        memory.wide = () if isinstance(found, Rejection) else memory.wide
        return found
    near = [n.block for n in candidates if _away(places, n) < places.search.gate_sigmas][:_FEW]
    if not set(near[:6]) <= set(memory.area):
        seen_too = {b for block in near for b in range(block - 1, block + 2)}  # what is seen reaches farther
        memory.area = tuple(sorted(b for b in seen_too if 0 <= b <= oldest))
        memory.submaps.joint(memory.area, mapper, memory.scans, graph)
        return None
    pyramid = memory.submaps.pyramid(memory.area, mapper, memory.scans, graph)
    maps = memory.submaps.joint(memory.area, mapper, memory.scans, graph)
    near_place = places.search.search(pyramid, guess, way.covariance, points)
    if near_place is None or not places.agrees(maps, near_place.pose, points):
        return Rejection.POOR
    memory.wide = tuple(sorted(blocks))
    memory.submaps.joint(memory.wide, mapper, memory.scans, graph)
    return None


def _told_apart(
    places: PlaceParameters, memory: Memory, mapper: OccupancyGridMapping, key: int,
    guess: FloatArray, spread: FloatArray, points: FloatArray,
) -> Tie | Rejection:  # fmt: skip
    """Search in all the places that the one found must be told from."""
    graph, blocks = memory.graph, memory.wide
    pyramid = memory.submaps.pyramid(blocks, mapper, memory.scans, graph)
    maps = memory.submaps.joint(blocks, mapper, memory.scans, graph)
    beyond = np.square(np.diag([places.unlike_m, places.unlike_m, places.unlike_rad]) / places.search.gate_sigmas)
    found = places.search.search(pyramid, guess, spread + beyond, points)
    if found is None:
        return Rejection.POOR
    if not places.is_plausible(spread, np.append((found.pose - guess)[:2], between(guess, found.pose)[2])):
        return Rejection.IMPLAUSIBLE
    if rejection := _judged(places, found, maps, points, memory, key):
        return rejection
    anchors = np.array([graph.poses[anchor_of(b)] for b in blocks])
    block = blocks[int(np.argmin(np.hypot(*(anchors[:, :2] - found.pose[:2]).T)))]
    anchor = graph.poses[anchor_of(block)]
    seen, most_m = between(anchor, found.pose), 3 * places.known_m
    tie = places.match_to(maps, anchor, memory, key, block, seen, most_m, Source.RECOGNIZED)
    return tie if isinstance(tie, Rejection) or tie.determined else Rejection.UNDETERMINED


def candidate_pieces(places: PlaceParameters, graph: KeyGraph, key: int) -> list[list[Nearby]]:
    """Old submaps that the robot may be in, by rigid piece; those that it would have to be moved least for first.

    Submaps between which the robot went on blindly make no map together, and are searched one piece at a time.
    """
    oldest, labels = key // BLOCK - places.gap, graph.pieces()
    found: dict[int, list[tuple[float, Nearby]]] = {}
    for nearby in graph.nearby(key, places.search.window_m / places.search.gate_sigmas, len(graph)):
        if nearby.block > oldest:
            continue
        away, sigma_m = _away(places, nearby), nearby.sigma_m
        if away * sigma_m < places.search.gate_sigmas * sigma_m + places.unlike_m:
            found.setdefault(int(labels[anchor_of(nearby.block)]), []).append((away, nearby))
    for piece in found.values():
        piece.sort(key=lambda f: (f[0], f[1].block))
    near = sorted((piece for piece in found.values() if piece[0][0] < places.search.gate_sigmas), key=lambda p: p[0][0])
    return [[nearby for _, nearby in piece[:_MOST_SUBMAPS]] for piece in near]


def _away(places: PlaceParameters, nearby: Nearby) -> float:
    """By how many standard deviations the robot would have to be elsewhere to be in a submap."""
    return max(math.hypot(nearby.pose[0], nearby.pose[1]) - places.near_m, 0.0) / nearby.sigma_m


def _judged(
    places: PlaceParameters, found: LatticeMatch, maps: TileMaps, points: FloatArray, memory: Memory, key: int
) -> Rejection | None:
    """What speaks against a place that was found."""
    if not places.agrees(maps, found.pose, points):
        return Rejection.POOR
    if found.runner_up_score > places.other_share * found.score:
        return Rejection.AMBIGUOUS
    through = evidence.through_walls(maps, found.pose, memory.scans.key(key))
    return Rejection.THROUGH_WALLS if through > places.through else None
