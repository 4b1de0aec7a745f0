"""Submaps: small maps of consecutive key scans, drawn when they are asked for."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np

from gridslam.grid.arena import Int32Array
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.matching.branch_and_bound import Pyramid
from gridslam.slam.key_graph import BLOCK, KeyGraph
from gridslam.slam.scan_archive import ScanArchive
from gridslam.types import FloatArray, IntArray

__all__ = ["ROW", "Submaps", "anchor_of", "draw", "drawn", "joint_map", "keys_of"]

ROW: Int32Array = np.array([0], np.int32)
"""The one row of a submap."""

_MOST_BYTES = 32_000_000
"""Of submaps that are kept: 32 of them inside, and few where a laser sees 80 m of open ground."""

_FEW = 12
"""Of so many submaps every other scan is drawn into one map, of more one in four."""


def keys_of(block: int, graph: KeyGraph) -> IntArray:
    """Key scans of a submap: those that no blind stretch of way divides from its anchor."""
    return graph.unbroken(np.arange(block * BLOCK, (block + 1) * BLOCK), anchor_of(block))


def anchor_of(block: int) -> int:
    """The key scan in whose frame a submap is."""
    return block * BLOCK + BLOCK // 2


def draw(maps: TileMaps, scans: ScanArchive, keys: Iterable[int], poses: Iterable[FloatArray]) -> None:
    """Draw key scans into the one map of `maps`, each at its pose (3,)."""
    for key, pose in zip(keys, poses, strict=True):
        maps.update(ROW, pose[None], scans.key(key))


def drawn(mapper: OccupancyGridMapping, scans: ScanArchive, keys: IntArray, poses: FloatArray) -> TileMaps:
    """Draw a new map of key scans `keys` (K,) at poses (K, 3)."""
    maps = mapper.empty(1)
    draw(maps, scans, keys.tolist(), poses)
    return maps


def joint_map(
    blocks: tuple[int, ...], mapper: OccupancyGridMapping, scans: ScanArchive, graph: KeyGraph
) -> TileMaps:
    """Draw one map of several blocks, each where the graph has its anchor."""
    stride = 2 if len(blocks) <= _FEW else 4  # neighbouring scans show much the same
    keys = [keys_of(block, graph)[::stride] for block in blocks]
    poses = [graph.local_poses(anchor_of(b), k) for b, k in zip(blocks, keys, strict=True)]
    return drawn(mapper, scans, np.concatenate(keys), np.concatenate(poses))


@final
class Submaps:
    """Draws the submap of a block in its anchor's frame, and keeps the last ones; what it keeps changes no result.

    Within a submap the scans lie as tracked, so that it stays as it is when the trajectory is corrected.
    """

    __slots__ = ("_joint", "_kept", "_most", "_pyramids")

    def __init__(self, most: int = 32) -> None:
        """Keep `most` submaps at a time, about 1 MB each, and less where they are larger."""
        self._kept: dict[int, TileMaps] = {}
        self._joint: dict[tuple[int, ...], TileMaps] = {}
        self._pyramids: dict[tuple[int, ...], Pyramid] = {}
        self._most = most

    def __call__(self, block: int, mapper: OccupancyGridMapping, scans: ScanArchive, graph: KeyGraph) -> TileMaps:
        """Give the submap of a block that is complete."""
        maps = self._kept.pop(block, None)
        if maps is None:
            keys, anchor = keys_of(block, graph), anchor_of(block)
            maps = drawn(mapper, scans, keys, graph.tracked_from(anchor, keys))
            while self._kept and (len(self._kept) >= self._most or self.nbytes + maps.nbytes > _MOST_BYTES):
                del self._kept[next(iter(self._kept))]
        self._kept[block] = maps  # the last used one comes last
        return maps

    @property
    def nbytes(self) -> int:
        """Bytes of the submaps that are kept."""
        return sum(maps.nbytes for maps in self._kept.values())

    def joint(
        self, blocks: tuple[int, ...], mapper: OccupancyGridMapping, scans: ScanArchive, graph: KeyGraph
    ) -> TileMaps:
        """Give `joint_map`, drawn once as long as the blocks are those of one of the last two; see `forget`."""
        if blocks not in self._joint:
            if len(self._joint) > 1:
                oldest = next(iter(self._joint))
                del self._joint[oldest]
                self._pyramids.pop(oldest, None)
            self._joint[blocks] = joint_map(blocks, mapper, scans, graph)
        return self._joint[blocks]

    def pyramid(
        self, blocks: tuple[int, ...], mapper: OccupancyGridMapping, scans: ScanArchive, graph: KeyGraph
    ) -> Pyramid:
        """Give the pyramid of `joint`, made once."""
        maps = self.joint(blocks, mapper, scans, graph)
        if blocks not in self._pyramids:
            self._pyramids[blocks] = Pyramid.of(maps, 0)
        return self._pyramids[blocks]

    def forget(self) -> None:
        """Draw the next joint maps anew: the poses have changed."""
        self._joint.clear()
        self._pyramids.clear()
