"""A run as it was at one of its key scans."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from gridslam.live.ancestry_tree import Float32Array
from gridslam.live.history import SCAN_UNIT_M, History, PastMaps, PastReplica
from gridslam.live.scene import Frame
from gridslam.types import FloatArray


@final
class Past(NamedTuple):
    """A run as it was at a moment.

    Attributes
    ----------
    keys : int
        Number of key scans until then.
    stamp_ns : int, ns
        Stamp of the last of them.
    pose : (3,) float64
        Estimated pose, x m, y m, theta rad.
    scan : (K, 2) float32, m
        End points of the scan in the robot frame.
    frame : Frame
        Path of the best particle at the key scans, NaN where the robot was lost; particles, each for a share of the
        belief; and the loop closures that had been found, where the path was then.
    """

    keys: int
    stamp_ns: int
    pose: FloatArray
    scan: Float32Array
    frame: Frame


@final
class PastReader:
    """Reads a history for one viewer, at any of its moments in any order.

    Attributes
    ----------
    replica : PastReplica
        The map as it was at the moment that was read last.
    """

    def __init__(self, history: History, maps: PastMaps) -> None:
        """Start before the first moment; all viewers share the maps."""
        self._history = history
        self._maps = maps
        self.replica = PastReplica()

    def reads(self, history: History) -> bool:
        """Return whether this is the history that is read."""
        return self._history is history

    def read(self, keys: int, *, has_maps: bool = True) -> Past | None:
        """Return the run after at most this number of key scans, and update the map; None before the first moment."""
        index = self._history.find(keys)
        if index < 0:
            return None
        moment = self._history.moments[index]
        if has_maps:
            self.replica.show(self._maps.at(index))
        scan = moment.scan.astype(np.float32) * np.float32(SCAN_UNIT_M)
        path = self._history.path(index)
        pairs = self._history.shown_closures
        ends = path[pairs[pairs[:, 1] < len(path)]].reshape(-1, 4)
        frame = Frame(path, particles=moment.particles, closures=ends)
        return Past(moment.keys, moment.stamp_ns, moment.pose, scan, frame)
