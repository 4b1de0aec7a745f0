"""Recognizing old places by scan matching, and believing it only when nothing speaks against it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import final

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass as parameters

from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam import place_evidence as evidence
from gridslam.slam.key_graph import BLOCK, KeyGraph, Nearby
from gridslam.slam.known_places import tie_known_place
from gridslam.slam.memory import Memory, Rejection
from gridslam.slam.place_parameters import PlaceParameters
from gridslam.slam.place_search import candidate_pieces, search_place
from gridslam.slam.submaps import anchor_of
from gridslam.slam.ties import Tie

__all__ = ["PlaceRecognition"]


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class PlaceRecognition(PlaceParameters):
    """Ties key scans to older submaps: those it still knows its way to, and those it recognizes.

    A place is recognized when the points of the last key scans fit the old map somewhere within what the drift allows
    (branch and bound), nowhere else within it as well, in all directions, without looking through walls, and when
    other searches nearby say the same.
    """

    def __call__(self, memory: Memory, mapper: OccupancyGridMapping) -> list[Tie]:
        """Look at the newest key scan; returns the ties of a place just recognized, which are in the graph, too."""
        graph = memory.graph
        newest = len(graph) - 1
        if newest // BLOCK < self.gap or len(memory.scans.key(newest)) < self.matcher.min_beams:
            return []
        if tie_known_place(self, memory, mapper):
            memory.hypotheses.clear()
            return []
        if newest < memory.next_search:
            return []
        pieces = candidate_pieces(self, graph, newest)
        if not pieces:
            memory.area = memory.wide = ()
            return []
        found = search_place(self, memory, mapper, newest, pieces[memory.failures % len(pieces)])
        if found is None:
            return []
        if isinstance(found, Rejection):
            self._reject(memory, found)
            return []
        memory.failures, memory.next_search = 0, newest + self.every
        recent = [*(h for h in memory.hypotheses if newest - h.to <= 6 * self.every), found]
        agreeing = [h for h in recent if self._agree(graph, h, found)]
        memory.hypotheses = recent
        if len(agreeing) < len(recent):
            memory.rejected[Rejection.INCONSISTENT] += 1
        if not self._convinces(agreeing, recent):
            return []
        memory.hypotheses = []
        for tie in agreeing:
            graph.add(tie)
        return agreeing

    def search_all(
        self, memory: Memory, mapper: OccupancyGridMapping, known: Sequence[Tie], tick: Callable[[], None]
    ) -> list[Tie]:
        """Search the whole log for places that `known` ties do not tell of yet.

        Returns ties of groups that agree with each other and with the motion between them: each is one place seen
        again, by as many searches as confirm it. The graph's poses and ties are those of the best answer so far.
        """
        graph, near = memory.graph, range(-self.every, self.every + 1)
        tied, labels = {tie.to + k for tie in known for k in near}, graph.pieces()
        groups: list[list[Tie]] = []
        for key in range(self.gap * BLOCK + self.every, len(graph), self.every):
            if key in tied or len(memory.scans.key(key)) < self.matcher.min_beams:
                continue
            for piece in candidate_pieces(self, graph, key):
                if piece[0].sigma_m < 2 * self.known_m or labels[anchor_of(piece[0].block)] != labels[key]:
                    continue  # key scans are matched to it without search; another piece is aligned as a whole
                found = self._searched(memory, mapper, key, piece)
                tick()
                if isinstance(found, Rejection):
                    memory.rejected[found] += 1
                elif found is not None:
                    self._group(graph, groups, found)
        found_all = [tie for group in groups for tie in group]
        return [tie for group in groups if self._convinces(group, found_all) for tie in group]

    def _searched(
        self, memory: Memory, mapper: OccupancyGridMapping, key: int, piece: list[Nearby]
    ) -> Tie | Rejection | None:
        """Search at a key scan to the end: maps are drawn when they are needed."""
        found = None
        for _ in range(3):
            found = found or search_place(self, memory, mapper, key, piece)
        return found

    def _group(self, graph: KeyGraph, groups: list[list[Tie]], found: Tie) -> None:
        """Add a tie to the group that it agrees with, or begin one."""
        for group in reversed(groups):
            if found.to - group[-1].to <= 6 * self.every and self._agree(graph, group[-1], found):
                group.append(found)
                return
        groups.append([found])

    def _convinces(self, group: list[Tie], found: list[Tie]) -> bool:
        """Whether a group has enough members, and more than twice as many as contradict it meanwhile."""
        meanwhile = sum(group[0].to <= tie.to <= group[-1].to for tie in found)
        return len(group) >= max(self.confirmations, 2 * (meanwhile - len(group)) + 1)

    def _reject(self, memory: Memory, reason: Rejection) -> None:
        """Count a place that was not believed; what fits nowhere is searched for less and less often."""
        memory.rejected[reason] += 1
        memory.failures = memory.failures + 1 if reason is Rejection.POOR else 0
        memory.next_search = len(memory.graph) - 1 + self.every * 2 ** min(max(memory.failures - 1, 0), 3)

    def _agree(self, graph: KeyGraph, earlier: Tie, later: Tie) -> bool:
        """Whether the motion between two key scans leads from the one place to the other."""
        missed = evidence.disagreement(graph, earlier, later)
        return math.hypot(missed[0], missed[1]) < self.agree_m and abs(missed[2]) < self.agree_rad
