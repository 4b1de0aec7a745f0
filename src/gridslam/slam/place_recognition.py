"""Recognizing old places by scan matching, and believing it only when nothing speaks against it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import final

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as parameters

from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam import place_checks as checks
from gridslam.slam.constraints import Constraint
from gridslam.slam.key_graph import KeyGraph, SubmapDistance
from gridslam.slam.loop_closure_state import LoopClosureState, RejectionReason
from gridslam.slam.place_recognition_parameters import PlaceRecognitionParameters
from gridslam.slam.place_search import find_candidate_submaps, search_place
from gridslam.slam.submap_index import KEY_SCANS_PER_SUBMAP, anchor_of, submap_of
from gridslam.slam.tracked_revisits import match_tracked_revisit

__all__ = ["PlaceRecognition"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceRecognition(PlaceRecognitionParameters):
    """Ties key scans to older submaps: those it still knows its way to, and those it recognizes.

    A place is recognized when the points of the last key scans fit the old map somewhere within what the drift allows
    (branch and bound), nowhere else within it as well, in all directions, without looking through walls, and when
    other searches nearby say the same.
    """

    def __call__(self, closure_state: LoopClosureState, mapper: OccupancyGridMapping) -> list[Constraint]:
        """Look at the newest key scan; returns the ties of a place just recognized, which are in the graph, too."""
        graph = closure_state.graph
        newest = len(graph) - 1
        if submap_of(newest) < self.recent_submaps or len(closure_state.scans.key(newest)) < self.matcher.least_beams:
            return []
        if match_tracked_revisit(self, closure_state, mapper):
            closure_state.unconfirmed.clear()
            return []
        if newest < closure_state.next_search:
            return []
        components = find_candidate_submaps(self, graph, newest)
        if not components:
            closure_state.search_submaps = closure_state.ambiguity_submaps = ()
            return []
        found = search_place(
            self, closure_state, mapper, newest, components[closure_state.failed_searches % len(components)]
        )
        if found is None:
            return []
        if isinstance(found, RejectionReason):
            self._count_rejection(closure_state, found)
            return []
        closure_state.failed_searches, closure_state.next_search = 0, newest + self.search_interval
        recent = [*(h for h in closure_state.unconfirmed if newest - h.to <= 6 * self.search_interval), found]
        agreeing = [h for h in recent if self._are_consistent(graph, h, found)]
        closure_state.unconfirmed = recent
        if len(agreeing) < len(recent):
            closure_state.rejected[RejectionReason.INCONSISTENT] += 1
        if not self._is_confirmed(agreeing, recent):
            return []
        closure_state.unconfirmed = []
        for constraint in agreeing:
            graph.add(constraint)
        return agreeing

    def search_whole_log(
        self,
        closure_state: LoopClosureState,
        mapper: OccupancyGridMapping,
        known: Sequence[Constraint],
        on_progress: Callable[[], None],
    ) -> list[Constraint]:
        """Search the whole log for places that `known` ties do not tell of yet.

        Returns ties of groups that agree with each other and with the motion between them: each is one place seen
        again, by as many searches as confirm it. The graph's poses and ties are those of the best answer so far.
        """
        graph, near = closure_state.graph, range(-self.search_interval, self.search_interval + 1)
        covered, labels = {constraint.to + k for constraint in known for k in near}, graph.label_rigid_components()
        groups: list[list[Constraint]] = []
        for key in range(
            self.recent_submaps * KEY_SCANS_PER_SUBMAP + self.search_interval, len(graph), self.search_interval
        ):
            if key in covered or len(closure_state.scans.key(key)) < self.matcher.least_beams:
                continue
            for component in find_candidate_submaps(self, graph, key):
                if (
                    component[0].sigma_m < 2 * self.certain_sigma_m
                    or labels[anchor_of(component[0].submap)] != labels[key]
                ):
                    continue  # key scans are matched to it without search; another piece is aligned as a whole
                found = self._search_to_end(closure_state, mapper, key, component)
                on_progress()
                if isinstance(found, RejectionReason):
                    closure_state.rejected[found] += 1
                elif found is not None:
                    self._add_to_group(graph, groups, found)
        found_all = [constraint for group in groups for constraint in group]
        return [constraint for group in groups if self._is_confirmed(group, found_all) for constraint in group]

    def _search_to_end(
        self, closure_state: LoopClosureState, mapper: OccupancyGridMapping, key: int, component: list[SubmapDistance]
    ) -> Constraint | RejectionReason | None:
        """Search at a key scan to the end: maps are drawn when they are needed."""
        found = None
        for _ in range(3):
            found = found or search_place(self, closure_state, mapper, key, component)
        return found

    def _add_to_group(self, graph: KeyGraph, groups: list[list[Constraint]], found: Constraint) -> None:
        """Add a tie to the group that it agrees with, or begin one."""
        for group in reversed(groups):
            if found.to - group[-1].to <= 6 * self.search_interval and self._are_consistent(graph, group[-1], found):
                group.append(found)
                return
        groups.append([found])

    def _is_confirmed(self, group: list[Constraint], found: list[Constraint]) -> bool:
        """Whether a group has enough members, and more than twice as many as contradict it meanwhile."""
        meanwhile = sum(group[0].to <= constraint.to <= group[-1].to for constraint in found)
        return len(group) >= max(self.min_confirmations, 2 * (meanwhile - len(group)) + 1)

    def _count_rejection(self, closure_state: LoopClosureState, reason: RejectionReason) -> None:
        """Count a place that was not believed; what fits nowhere is searched for less and less often."""
        closure_state.rejected[reason] += 1
        closure_state.failed_searches = (
            closure_state.failed_searches + 1 if reason is RejectionReason.LOW_INLIER_RATIO else 0
        )
        closure_state.next_search = (
            len(closure_state.graph) - 1 + self.search_interval * 2 ** min(max(closure_state.failed_searches - 1, 0), 3)
        )

    def _are_consistent(self, graph: KeyGraph, earlier: Constraint, later: Constraint) -> bool:
        """Whether the motion between two key scans leads from the one place to the other."""
        missed = checks.relative_error(graph, earlier, later)
        return math.hypot(missed[0], missed[1]) < self.consistency_m and abs(missed[2]) < self.consistency_rad
