"""Submaps: small maps of consecutive key scans, drawn when they are asked for."""

from __future__ import annotations

from typing import final

import numpy as np

from gridslam.geometry.se2 import between
from gridslam.grid.arena import Int32Array
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.key_graph import BLOCK, KeyGraph
from gridslam.slam.scan_archive import ScanArchive
from gridslam.types import FloatArray, IntArray

__all__ = ["ROW", "Submaps", "anchor_of", "drawn", "keys_of"]

ROW: Int32Array = np.array([0], np.int32)
"""The one row of a submap."""


def keys_of(block: int) -> IntArray:
    """Key scans of a submap."""
    return np.arange(block * BLOCK, (block + 1) * BLOCK)


def anchor_of(block: int) -> int:
    """The key scan in whose frame a submap is."""
    return block * BLOCK + BLOCK // 2


def drawn(mapper: OccupancyGridMapping, scans: ScanArchive, keys: IntArray, poses: FloatArray) -> TileMaps:
    """Draw a map of key scans `keys` (K,) at poses (K, 3)."""
    maps = mapper.empty(1)
    for key, pose in zip(keys.tolist(), poses, strict=True):
        maps.update(ROW, pose[None], scans.key(key))
    return maps


@final
class Submaps:
    """Draws the submap of a block in its anchor's frame, and keeps the last ones; what it keeps changes no result.

    Within a submap the scans lie as tracked, so that it stays as it is when the trajectory is corrected.
    """

    __slots__ = ("_kept", "_most")

    def __init__(self, most: int = 32) -> None:
        """Keep `most` submaps at a time: about 1 MB each."""
        self._kept: dict[int, TileMaps] = {}
        self._most = most

    def __call__(self, block: int, mapper: OccupancyGridMapping, scans: ScanArchive, graph: KeyGraph) -> TileMaps:
        """Give the submap of a block that is complete."""
        maps = self._kept.pop(block, None)
        if maps is None:
            keys, anchor = keys_of(block), anchor_of(block)
            local = between(graph.tracked[anchor], np.array([graph.tracked[k] for k in keys.tolist()]))
            maps = drawn(mapper, scans, keys, local)
            if len(self._kept) >= self._most:
                del self._kept[next(iter(self._kept))]
        self._kept[block] = maps  # the last used one comes last
        return maps
