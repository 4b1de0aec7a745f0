"""One link of the tree of frames: where a frame lies in its parent, at the stamps that are kept."""

from __future__ import annotations

from bisect import bisect_left
from enum import Enum
from typing import final

from gridslam.geometry import rigid
from gridslam.geometry.rigid import Rigid


class Coverage(Enum):
    """Whether a transform is known at a stamp."""

    KNOWN = "known"
    NOT_YET = "after the last reading of a link: it may come"
    TOO_EARLY = "before the first reading of a link that is kept: it will not come"
    NOT_CONNECTED = "no chain of links joins the frames so far"


@final
class Link:
    """Readings of `parent_from_child` in the order of their stamps, those within `keep_ns` of the latest.

    `fixed` is the value of a static link, None for a dynamic one.
    """

    __slots__ = ("_keep_ns", "_motions", "_stray", "child", "fixed", "parent", "stamps_ns")

    def __init__(self, parent: str, child: str, keep_ns: int) -> None:
        self.parent = parent
        self.child = child
        self.fixed: Rigid | None = None
        self.stamps_ns: list[int] = []
        self._keep_ns = keep_ns
        self._motions: list[Rigid] = []
        self._stray: tuple[int, Rigid] | None = None

    def __len__(self) -> int:
        """Return the number of readings kept, 1 for a static link."""
        return len(self.stamps_ns) or 1

    def fix(self, motion: Rigid) -> None:
        """Set the value of a static link; a link that moves stays dynamic."""
        if not self.stamps_ns:
            self.fixed = motion

    def add(self, stamp_ns: int, motion: Rigid) -> None:
        """Add a dynamic reading; the link is dynamic from then on.

        The first reading of a stamp stays. One that is older than those kept is left out; a second one from that past
        restarts the link there: one alone is an error, two are a clock that was set back.
        """
        self.fixed = None
        stamps = self.stamps_ns
        if stamps and stamp_ns < stamps[-1] - self._keep_ns:
            self._add_stray(stamp_ns, motion)
            return
        place = bisect_left(stamps, stamp_ns)
        if stamp_ns in stamps[place : place + 1]:
            return
        stamps.insert(place, stamp_ns)
        self._motions.insert(place, motion)
        if place == len(stamps) - 1:
            self._stray = None
            gone = bisect_left(stamps, stamp_ns - self._keep_ns)
            del stamps[:gone], self._motions[:gone]

    def ends_before(self, stamp_ns: int) -> bool:
        """Return whether the readings end so long before a stamp that the link counts as silent."""
        return self.stamps_ns[-1] < stamp_ns - self._keep_ns

    def coverage(self, stamp_ns: int) -> Coverage:
        """Return whether the link is known at a stamp."""
        stamps = self.stamps_ns
        if self.fixed is not None or stamps[0] <= stamp_ns <= stamps[-1]:
            return Coverage.KNOWN
        return Coverage.TOO_EARLY if stamp_ns < stamps[0] else Coverage.NOT_YET

    def at(self, stamp_ns: int) -> Rigid:
        """Return value at a stamp at which the link is known, interpolated between two readings."""
        if self.fixed is not None:
            return self.fixed
        after = bisect_left(self.stamps_ns, stamp_ns)
        end = self.stamps_ns[after]
        if end == stamp_ns:
            return self._motions[after]
        start = self.stamps_ns[after - 1]
        fraction = (stamp_ns - start) / (end - start)
        return rigid.interpolate(self._motions[after - 1], self._motions[after], fraction)

    def _add_stray(self, stamp_ns: int, motion: Rigid) -> None:
        stray = self._stray
        if stray is None or not 0 < stamp_ns - stray[0] <= self._keep_ns:
            self._stray = (stamp_ns, motion)
            return
        self.stamps_ns[:] = [stray[0], stamp_ns]
        self._motions[:] = [stray[1], motion]
        self._stray = None
