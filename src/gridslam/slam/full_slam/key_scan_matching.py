"""Matching key scans to the submaps of other times that lie about them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import final

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, anchor_of, submap_of
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.loop_closure.submaps import build_map, key_scans_of
from gridslam.types import FloatArray

__all__ = ["VISIT_GAP", "KeyScanMatching"]

_RECENT_SUBMAPS = 3
"""Submaps so near in time show what the tracker has matched already."""

VISIT_GAP = 3
"""Key scans farther apart than this in time belong to different visits of a submap."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class KeyScanMatching:
    """Matches key scans to overlapping submaps that are rebuilt from a trajectory.

    Only submaps of the same rigid component (see `KeyGraph.label_rigid_components`): across a gap in the laser data,
    nearby poses are no evidence of a revisit. Frozen key scans are not matched to each other.

    Parameters
    ----------
    max_distance_m : float, m
        A key scan is matched to submaps with a key scan this near.
    max_submaps : int
        The nearest of them.
    inlier_ratio : float
        Minimum inlier ratio.
    min_information : float
        Least eigenvalue of the position's information, per agreeing beam.
    max_correction_m : float, m
        Maximum correction of a match.
    beam_sigma_m : float, m
        Standard deviation of one beam, inflated for correlated beams and cell size. Constraints of one visit, of
        consecutive key scans to one submap, share its errors: their information is that of one, divided among them.
    matcher : GaussNewton
        How a key scan is matched.
    """

    max_distance_m: float = Field(default=3.0, ge=1e-6, le=1e6)
    max_submaps: int = Field(default=3, ge=1, le=1000)
    inlier_ratio: float = Field(default=0.7, ge=1e-6, le=1)
    min_information: float = Field(default=0.1, ge=0, le=1e6)
    max_correction_m: float = Field(default=0.4, ge=1e-6, le=1e6)
    beam_sigma_m: float = Field(default=0.05, ge=1e-6, le=100)
    matcher: GaussNewton = GaussNewton()

    def __call__(
        self,
        closure_state: LoopClosureState,
        poses: FloatArray,
        mapper: OccupancyGridMapping,
        on_progress: Callable[[], None],
    ) -> Iterator[Constraint]:
        """Match key scans to the submaps about them."""
        wanted = self._nearby_key_scans(closure_state, poses)
        loose = 1e-6 * np.eye(3)
        for submap, members in enumerate(wanted):
            if not members:
                continue
            on_progress()
            anchor = anchor_of(submap)
            keys = key_scans_of(submap, closure_state.graph)
            maps = build_map(mapper, closure_state.scans, keys, between(poses[anchor], poses[keys]))
            batch = closure_state.scans.batch([closure_state.scans.keys[key] for key in members])
            guesses = between(poses[anchor], poses[members])
            matches = self.matcher.match_scans(maps, guesses, loose, batch)
            moved = between(guesses, matches.poses)
            beams = np.diff(batch.starts)
            is_match = beams >= self.matcher.min_beams
            is_match &= matches.score >= np.maximum(self.inlier_ratio * beams, 1.0)
            is_match &= np.hypot(moved[:, 0], moved[:, 1]) <= self.max_correction_m
            visit: list[Constraint] = []
            for k in np.flatnonzero(is_match).tolist():
                key = members[k]
                if visit and key > visit[-1].to + VISIT_GAP:
                    yield from _divide_information(visit)
                    visit = []
                visit.append(
                    Constraint.from_match(
                        *(anchor, key, guesses[k], matches.only(k), self.beam_sigma_m, self.min_information),
                        ConstraintSource.PROXIMITY,
                    )
                )
            yield from _divide_information(visit)

    def _nearby_key_scans(self, closure_state: LoopClosureState, poses: FloatArray) -> list[list[int]]:
        """For each submap the key scans to match to it."""
        from scipy.spatial import KDTree  # imported lazily: only needed for loop closure

        graph = closure_state.graph
        components = graph.label_rigid_components()
        wanted: list[list[int]] = [[] for _ in range(graph.complete_submaps)]
        complete = graph.complete_submaps * KEY_SCANS_PER_SUBMAP
        for key, near in enumerate(KDTree(poses[:, :2]).query_ball_point(poses[:, :2], self.max_distance_m)):
            others = np.array([k for k in near if k < complete], np.int64)
            submaps = others // KEY_SCANS_PER_SUBMAP
            is_left_out = np.abs(submaps - submap_of(key)) <= _RECENT_SUBMAPS
            if key < graph.frozen:
                is_left_out |= anchor_of(0) + KEY_SCANS_PER_SUBMAP * submaps < graph.frozen
            others = others[~is_left_out & (components[others] == components[key])]
            turned = np.abs(wrap(poses[others, 2] - poses[key, 2]))
            away = np.hypot(*(poses[others, :2] - poses[key, :2]).T) + 0.5 * turned
            nearest = dict.fromkeys((others[np.lexsort((others, away))] // KEY_SCANS_PER_SUBMAP).tolist())
            for submap in list(nearest)[: self.max_submaps]:
                wanted[submap].append(key)
        return wanted


def _divide_information(visit: list[Constraint]) -> Iterator[Constraint]:
    """The constraints of one visit, which together have the information of one."""
    for constraint in visit:
        yield constraint._replace(information=constraint.information / len(visit))
