"""The particles' ancestry at any time of a recorded run."""

from __future__ import annotations

from typing import final

import numpy as np

from gridslam.io.results.record import Record, RecordFlag
from gridslam.particles.ancestry import Ancestry

__all__ = ["AncestryReplay"]

_SNAPSHOTS = 32  # of the ancestry, evenly over the record: seeking back replays at most one interval


@final
class AncestryReplay:
    """Replays the ancestry of a record, forwards step by step and backwards from the previous snapshot.

    Parameters
    ----------
    record : Record
        At least one key scan.
    """

    def __init__(self, record: Record) -> None:
        """Start at the first key scan."""
        self._record = record
        self._interval = max(len(record) // _SNAPSHOTS, 1)
        self._at, self._ancestry = 0, Ancestry.start(record.poses[0])
        self._snapshots = {0: self._ancestry.snapshot()}

    def at(self, key: int) -> Ancestry:
        """Return the ancestry at a key scan, before its resampling; valid until the next call."""
        near = max(kept for kept in self._snapshots if kept <= key)
        if not near <= self._at <= key:
            self._at, self._ancestry = near, self._snapshots[near].snapshot()
        while self._at < key:
            self._advance()
        return self._ancestry

    def find_relative(self, particle: int, before: int, after: int) -> int:
        """Return the descendant or ancestor at key scan `after` of a particle at `before`; -1 if there is none.

        Of several descendants it is the first.
        """
        parents = self._record.parents
        if particle < 0:
            return -1
        for key in range(before - 1, after - 1, -1):
            particle = int(parents[key, particle])
        if after <= before:
            return particle
        ancestors = np.arange(parents.shape[1])
        for key in range(after - 1, before - 1, -1):
            ancestors = parents[key, ancestors]
        descendants = np.flatnonzero(ancestors == particle)
        return int(descendants[0]) if len(descendants) else -1

    def _advance(self) -> None:
        record, at = self._record, self._at
        if record.flags[at] & RecordFlag.RESAMPLED:
            self._ancestry.resample(record.parents[at])
        self._ancestry.extend(record.poses[at + 1])
        self._at = at + 1
        if self._at % self._interval == 0 and self._at not in self._snapshots:
            self._snapshots[self._at] = self._ancestry.snapshot()
