"""The submaps of a run, cut from its way, and their matches."""

from __future__ import annotations

from collections.abc import Iterator
from typing import final

import numpy as np

from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submap_matching import (
    MAX_POINTS,
    DrawnSubmap,
    Submap,
    is_same_place,
    propose_poses,
    verify_pose,
)
from gridslam.slam.loop_closure.walls import leave_open
from gridslam.types import FloatArray, Match

_FEWEST_KEY_SCANS = 5
_MOST_DRAWN = 8
"""Drawn submaps that are kept, 1 to 4 MB each."""


@final
class SubmapPairs:
    """The submaps of a run in the order of the way, and their matches, each computed once.

    Submaps lie as they were tracked: what was matched holds whatever becomes of the trajectory. All this follows from
    the key scans, and is not saved.
    """

    __slots__ = ("_cut", "_drawn", "_next_m", "_proposed", "_stretch", "_verified", "submaps")

    def __init__(self) -> None:
        self.submaps: list[Submap] = []
        self._stretch = 0  # between gaps in the laser data, of which ...
        self._cut = 0  # ... the first submaps were cut
        self._next_m = -1.0  # driven when the next submap is complete
        self._proposed: dict[tuple[int, int], list[FloatArray]] = {}
        self._verified: dict[tuple[int, int, int], Match | None] = {}
        self._drawn: dict[int, DrawnSubmap] = {}

    def cut(
        self,
        graph: KeyGraph,
        scans: ScanArchive,
        mapper: OccupancyGridMapping,
        length_m: float,
        step_m: float,
        is_over: bool = False,
    ) -> None:
        """Divide the completed part of the trajectory into overlapping submaps, none across a gap in the laser data.

        A stretch between gaps ends with a submap of what is left; the last one does so when the drive `is_over`.
        """
        way, labels = graph.driven_m(), graph.label_gaps()
        stretches = int(labels[-1]) + 1
        if stretches == self._stretch + 1 and way[-1] <= self._next_m and not is_over:
            return
        for stretch in range(self._stretch, stretches):
            own = np.flatnonzero(labels == stretch)
            begin, end = way[own[[0, -1]]].tolist()
            last = max(end - length_m, begin)
            is_complete = is_over or stretch + 1 < stretches
            firsts = [*np.arange(begin, last, step_m).tolist(), *([last] if is_complete else [])]
            for first in firsts[self._cut :]:
                keys = own[(way[own] >= first) & (way[own] <= first + length_m)]
                if len(keys) >= _FEWEST_KEY_SCANS:
                    self.submaps.append(Submap.of(graph, int(keys[len(keys) // 2]), keys, scans, mapper))
            self._stretch, self._cut = (stretch + 1, 0) if is_complete else (stretch, len(firsts))
            self._next_m = begin + self._cut * step_m + length_m

    def propose(self, older: int, newer: int) -> list[FloatArray]:
        """Propose poses (3,) of a submap in another one's frame."""
        pair = (older, newer)
        if pair not in self._proposed:
            self._proposed[pair] = propose_poses(self.submaps[older].features, self.submaps[newer].features)
        return self._proposed[pair]

    def verify(self, older: int, newer: int, numbers: list[int]) -> Iterator[Match]:
        """Yield the distinct matches at proposed poses, by their numbers."""
        found: list[FloatArray] = []
        for number in numbers:
            key = (older, newer, number)
            if key not in self._verified:
                begin = self._proposed[older, newer][number]
                self._verified[key] = verify_pose(self._draw(older), self._draw(newer), begin)
            match = self._verified[key]
            if match is not None and not any(is_same_place(match.poses[0], other) for other in found):
                found.append(match.poses[0])
                yield match

    def leave_open(self, older: int, newer: int, pose: FloatArray) -> bool:
        """Whether the walls of a submap fit beside a pose (3,) in an older one, too."""
        return leave_open(self._draw(older).maps, self.submaps[newer].walls, pose)

    def count_within(self, key_scans: int) -> int:
        """Count the submaps of the first key scans."""
        return sum(int(submap.keys[-1]) < key_scans for submap in self.submaps)

    def copy(self) -> SubmapPairs:
        """Return an independent copy; submaps are shared."""
        twin = SubmapPairs()
        for name in self.__slots__:
            value = getattr(self, name)
            setattr(twin, name, value if isinstance(value, int | float) else value.copy())
        return twin

    def _draw(self, number: int) -> DrawnSubmap:
        """Draw a submap, or take it where it was drawn lately."""
        drawn = self._drawn.pop(number, None) or self.submaps[number].draw(MAX_POINTS)
        while len(self._drawn) >= _MOST_DRAWN:
            del self._drawn[next(iter(self._drawn))]
        self._drawn[number] = drawn  # the last used one comes last
        return drawn
