"""One link of the tree of frames: where a child lies in its parent, at the stamps that are kept."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import final

from gridslam.geometry import rigid
from gridslam.geometry.rigid import Rigid
from gridslam.transforms.missing import Coverage

__all__ = ["Link", "LinkStatistics"]


@final
@dataclass(slots=True)
class LinkStatistics:
    """What was met at one link since the beginning.

    Attributes
    ----------
    readings : int
        All that came, the left-out ones too.
    first_stamp_ns, last_stamp_ns : int or None
        Least and greatest stamp of a dynamic reading that was taken; None where there is none.
    repeated, contradicted : int
        Readings at a stamp that was known: with the same value, or with another one. The first stays; of a static
        link the last. Static readings of a link that moves contradict too. Contradictions indicate two publishers.
    late : int
        Readings that came after one of a later stamp, and were put in their place.
    strays : int
        Single readings from more than the time kept before the latest: left out.
    restarts : int
        Times that the stamps jumped back by more than the time kept and stayed there; the link was restarted.
    publishers : set of str
        Names of its publishers, if known.
    """

    readings: int = 0
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None
    repeated: int = 0
    contradicted: int = 0
    late: int = 0
    strays: int = 0
    restarts: int = 0
    publishers: set[str] = field(default_factory=set)

    def taken(self, stamp_ns: int) -> None:
        """Note a reading that was taken."""
        if self.first_stamp_ns is None or self.last_stamp_ns is None:
            self.first_stamp_ns = self.last_stamp_ns = stamp_ns
        elif stamp_ns > self.last_stamp_ns:
            self.last_stamp_ns = stamp_ns
        elif stamp_ns < self.first_stamp_ns:
            self.first_stamp_ns = stamp_ns


@final
class Link:
    """Readings of `parent_from_child` in the order of their stamps, those within `keep_ns` of the latest.

    `fixed` is the value of a static link, None for a dynamic one.
    """

    __slots__ = ("_keep_ns", "_motions", "_stray", "child", "fixed", "parent", "stamps_ns", "statistics")

    def __init__(self, parent: str, child: str, keep_ns: int) -> None:
        self.parent, self.child = parent, child
        self.fixed: Rigid | None = None
        self.stamps_ns: list[int] = []
        self.statistics = LinkStatistics()
        self._keep_ns = keep_ns
        self._motions: list[Rigid] = []
        self._stray: tuple[int, Rigid] | None = None

    def __len__(self) -> int:
        """Return the number of readings kept, 1 for a static link."""
        return len(self.stamps_ns) or 1

    def fix(self, motion: Rigid) -> bool:
        """Add a static reading; return whether it changed the link; one that moves stays dynamic."""
        self.statistics.readings += 1
        changed = motion != self.fixed
        self.statistics.repeated += not changed
        self.statistics.contradicted += changed and (self.fixed is not None or bool(self.stamps_ns))
        if changed and not self.stamps_ns:
            self.fixed = motion
            return True
        return False

    def add(self, stamp_ns: int, motion: Rigid) -> None:
        """Add a dynamic reading, or skip it as described in `LinkStatistics`."""
        stamps, statistics = self.stamps_ns, self.statistics
        statistics.readings += 1
        if stamps and stamp_ns <= stamps[-1]:
            self._add_back(stamp_ns, motion)
            return
        stamps.append(stamp_ns)
        self._motions.append(motion)
        self._stray = None
        statistics.taken(stamp_ns)
        oldest = stamp_ns - self._keep_ns
        if stamps[0] < oldest:
            gone = bisect_left(stamps, oldest)
            del stamps[:gone], self._motions[:gone]

    def coverage(self, stamp_ns: int) -> Coverage:
        """Whether the link is known at a stamp."""
        stamps = self.stamps_ns
        if self.fixed is not None or stamps[0] <= stamp_ns <= stamps[-1]:
            return Coverage.KNOWN
        return Coverage.TOO_EARLY if stamp_ns < stamps[0] else Coverage.NOT_YET

    def at(self, stamp_ns: int) -> Rigid | None:
        """Value of a dynamic link at a stamp, interpolated; None outside the readings kept."""
        stamps = self.stamps_ns
        after = bisect_left(stamps, stamp_ns)
        if after == len(stamps):
            return None
        end = stamps[after]
        if end == stamp_ns:
            return self._motions[after]
        if after == 0:
            return None
        start = stamps[after - 1]
        fraction = (stamp_ns - start) / (end - start)
        return rigid.interpolate(self._motions[after - 1], self._motions[after], fraction)

    def _add_back(self, stamp_ns: int, motion: Rigid) -> None:
        """Take a reading that is not later than the latest."""
        stamps, statistics = self.stamps_ns, self.statistics
        if stamp_ns < stamps[-1] - self._keep_ns:
            self._add_far_back(stamp_ns, motion)
            return
        place = bisect_left(stamps, stamp_ns)
        if stamps[place] == stamp_ns:
            same = self._motions[place] == motion
            statistics.repeated += same
            statistics.contradicted += not same
            return
        stamps.insert(place, stamp_ns)
        self._motions.insert(place, motion)
        statistics.late += 1
        statistics.taken(stamp_ns)

    def _add_far_back(self, stamp_ns: int, motion: Rigid) -> None:
        """Restart at the second consecutive reading from the same past: one alone is an error, two are a clock."""
        stray, statistics = self._stray, self.statistics
        if stray is None or not 0 < stamp_ns - stray[0] <= self._keep_ns:
            self._stray = (stamp_ns, motion)
            statistics.strays += 1
            return
        statistics.strays -= 1
        statistics.restarts += 1
        self.stamps_ns[:] = [stray[0], stamp_ns]
        self._motions[:] = [stray[1], motion]
        self._stray = None
        statistics.taken(stray[0])
