"""Place recognition by scan matching, with rejection of ambiguous and inconsistent matches."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import final

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as parameters

from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.loop_closure import place_checks as checks
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.key_graph import KeyGraph, SubmapDistance
from gridslam.slam.loop_closure.place_recognition_parameters import PlaceRecognitionParameters
from gridslam.slam.loop_closure.place_search import find_candidate_submaps, search_place
from gridslam.slam.loop_closure.state import LoopClosureState, RejectionReason
from gridslam.slam.loop_closure.submap_index import KEY_SCANS_PER_SUBMAP, anchor_of, submap_of
from gridslam.slam.loop_closure.tracked_revisits import match_tracked_revisit

__all__ = ["PlaceRecognition"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceRecognition(PlaceRecognitionParameters):
    """Adds constraints from key scans to older submaps: tracked revisits and recognized places.

    A place is recognized if the points of the last key scans match the old map within the pose uncertainty (branch and
    bound), the match is unique, has no degenerate direction, passes no beams through walls, and is confirmed by the
    next searches.
    """

    def __call__(self, closure_state: LoopClosureState, mapper: OccupancyGridMapping) -> list[Constraint]:
        """Process the newest key scan; return the constraints of a newly recognized place, also added to the graph."""
        graph = closure_state.graph
        newest = len(graph) - 1
        if submap_of(newest) < self.recent_submaps or len(closure_state.scans.key(newest)) < self.matcher.min_beams:
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
        """Search the whole log for revisits that the constraints `known` do not cover.

        Returns groups of constraints that are consistent with each other and with the tracked motion between them; each
        group is one confirmed revisit. The poses and constraints of the graph are those of the best candidate so far.
        """
        graph, near = closure_state.graph, range(-self.search_interval, self.search_interval + 1)
        covered, labels = {constraint.to + k for constraint in known for k in near}, graph.label_rigid_components()
        groups: list[list[Constraint]] = []
        for key in range(
            self.recent_submaps * KEY_SCANS_PER_SUBMAP + self.search_interval, len(graph), self.search_interval
        ):
            if key in covered or len(closure_state.scans.key(key)) < self.matcher.min_beams:
                continue
            for component in find_candidate_submaps(self, graph, key):
                if (
                    component[0].sigma_m < 2 * self.certain_sigma_m
                    or labels[anchor_of(component[0].submap)] != labels[key]
                ):
                    continue  # tracked revisit: matched without a search; another piece is aligned as a whole
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
        """Run all stages of the search at one key scan."""
        found = None
        for _ in range(3):
            found = found or search_place(self, closure_state, mapper, key, component)
        return found

    def _add_to_group(self, graph: KeyGraph, groups: list[list[Constraint]], found: Constraint) -> None:
        """Add a constraint to the consistent group, or start a new one."""
        for group in reversed(groups):
            if found.to - group[-1].to <= 6 * self.search_interval and self._are_consistent(graph, group[-1], found):
                group.append(found)
                return
        groups.append([found])

    def _is_confirmed(self, group: list[Constraint], found: list[Constraint]) -> bool:
        """Whether a group has enough members, and a majority of the candidates in its interval."""
        meanwhile = sum(group[0].to <= constraint.to <= group[-1].to for constraint in found)
        return len(group) >= max(self.min_confirmations, 2 * (meanwhile - len(group)) + 1)

    def _count_rejection(self, closure_state: LoopClosureState, reason: RejectionReason) -> None:
        """Count a rejected candidate; after repeated failures the search interval grows."""
        closure_state.rejected[reason] += 1
        closure_state.failed_searches = (
            closure_state.failed_searches + 1 if reason is RejectionReason.LOW_INLIER_RATIO else 0
        )
        closure_state.next_search = (
            len(closure_state.graph) - 1 + self.search_interval * 2 ** min(max(closure_state.failed_searches - 1, 0), 3)
        )

    def _are_consistent(self, graph: KeyGraph, earlier: Constraint, later: Constraint) -> bool:
        """Whether two candidates are consistent with the tracked motion between their key scans."""
        missed = checks.relative_error(graph, earlier, later)
        return math.hypot(missed[0], missed[1]) < self.consistency_m and abs(missed[2]) < self.consistency_rad
