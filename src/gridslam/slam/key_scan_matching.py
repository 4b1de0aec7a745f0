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
from gridslam.slam.key_graph import BLOCK
from gridslam.slam.memory import Memory
from gridslam.slam.submaps import ROW, anchor_of, drawn, keys_of
from gridslam.slam.ties import Source, Tie, surveyed
from gridslam.types import FloatArray

__all__ = ["KeyScanMatching"]

_OWN = 3
"""Submaps so near in time show what the tracker has matched already."""


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class KeyScanMatching:
    """Ties key scans to the submaps about them, drawn anew from a trajectory.

    Only submaps of the same rigid piece (see `KeyGraph.pieces`): that two places lie about each other in a trajectory
    proves nothing where the robot went on blindly in between.

    Parameters
    ----------
    near_m : float, m
        A key scan is matched to submaps with a key scan this near.
    submaps : int
        The nearest of them.
    share : float
        Share of the beams that must agree.
    least_information : float
        Least eigenvalue of the position's information, per agreeing beam.
    most_m : float, m
        A match that moves a key scan farther is not believed.
    beam_sigma_m : float, m
        Standard deviation of what one beam says, beams being correlated and walls a cell thick.
    matcher : GaussNewton
        How a key scan is matched.
    """

    near_m: float = Field(default=3.0, gt=0)
    submaps: int = Field(default=3, ge=1)
    share: float = Field(default=0.7, gt=0, le=1)
    least_information: float = Field(default=0.1, ge=0)
    most_m: float = Field(default=0.4, gt=0)
    beam_sigma_m: float = Field(default=0.3, gt=0)
    matcher: GaussNewton = GaussNewton()

    def __call__(
        self, memory: Memory, poses: FloatArray, mapper: OccupancyGridMapping, tick: Callable[[], None]
    ) -> Iterator[Tie]:
        """Match key scans to the submaps about them."""
        wanted = self._wanted(memory, poses)
        loose = np.full((1, 3, 3), 1e-6) * np.eye(3)
        for block, members in enumerate(wanted):
            if not members:
                continue
            tick()
            anchor = anchor_of(block)
            keys = keys_of(block, memory.graph)
            maps = drawn(mapper, memory.scans, keys, between(poses[anchor], poses[keys]))
            for key in members:
                beams = memory.scans.key(key)
                if len(beams) < self.matcher.min_beams:
                    continue
                guess = between(poses[anchor], poses[key])
                match = surveyed(self.matcher(maps, ROW, guess[None], loose, beams), maps, ROW, beams)
                moved = between(guess, match.poses[0])
                score = float(match.score[0])
                if score < max(self.share * len(beams), 1.0) or np.hypot(moved[0], moved[1]) > self.most_m:
                    continue
                yield Tie.of(anchor, key, guess, match, self.beam_sigma_m, self.least_information, Source.BELIEVED)

    def _wanted(self, memory: Memory, poses: FloatArray) -> list[list[int]]:
        """For each submap the key scans to match to it."""
        from scipy.spatial import cKDTree  # only who closes loops pays for its import

        blocks, pieces = memory.graph.blocks, memory.graph.pieces()
        wanted: list[list[int]] = [[] for _ in range(blocks)]
        tree, complete = cKDTree(poses[:, :2]), blocks * BLOCK
        for key, near in enumerate(tree.query_ball_point(poses[:, :2], self.near_m)):
            block = key // BLOCK
            others = np.array([k for k in near if k < complete and abs(k // BLOCK - block) > _OWN], np.int64)
            others = others[pieces[others] == pieces[key]]
            away = np.hypot(*(poses[others, :2] - poses[key, :2]).T) + 0.5 * np.abs(
                wrap(poses[others, 2] - poses[key, 2])
            )
            nearest = dict.fromkeys((others[np.lexsort((others, away))] // BLOCK).tolist())
            for block in list(nearest)[: self.submaps]:
                wanted[block].append(key)
        return wanted
