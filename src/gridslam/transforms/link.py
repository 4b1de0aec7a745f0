"""One link of the tree of frames, and chains of links: where a frame lies in another, at the stamps that are kept."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from enum import Enum
from functools import reduce
from itertools import groupby
from typing import NamedTuple, final

from gridslam.geometry import rigid
from gridslam.geometry.rigid import Rigid

_IDENTITY: Rigid = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


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

    def fix(self, motion: Rigid) -> bool:
        """Set the value of a static link, and return whether it changed; a link that moves stays dynamic."""
        if self.stamps_ns or motion == self.fixed:
            return False
        self.fixed = motion
        return True

    def add(self, stamp_ns: int, motion: Rigid) -> bool:
        """Add a dynamic reading, and return whether the link was static before.

        The first reading of a stamp stays. One that is older than those kept is left out; a second one from that past
        restarts the link there: one alone is an error, two are a clock that was set back.
        """
        was_static = self.fixed is not None
        self.fixed = None
        stamps = self.stamps_ns
        if stamps and stamp_ns < stamps[-1] - self._keep_ns:
            self._add_stray(stamp_ns, motion)
            return was_static
        place = bisect_left(stamps, stamp_ns)
        if stamp_ns in stamps[place : place + 1]:
            return was_static
        stamps.insert(place, stamp_ns)
        self._motions.insert(place, motion)
        if place == len(stamps) - 1:
            self._stray = None
            gone = bisect_left(stamps, stamp_ns - self._keep_ns)
            del stamps[:gone], self._motions[:gone]
        return was_static

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


class _Step(NamedTuple):
    """A link of a chain, which may lead up, from child to parent."""

    link: Link
    up: bool

    def at(self, stamp_ns: int) -> Rigid:
        motion = self.link.at(stamp_ns)
        return rigid.inverse(motion) if self.up else motion


@final
class Chain:
    """The way from `target` over `links` to a source frame.

    Static links that follow each other are composed once. Valid until a link is added or a static one changes.
    """

    __slots__ = ("_moving", "_parts", "frames", "links")

    def __init__(self, target: str, links: Sequence[Link]) -> None:
        frames = [target]
        steps = []
        for link in links:
            up = link.child == frames[-1]
            frames.append(link.parent if up else link.child)
            steps.append(_Step(link, up))
        self.frames = tuple(frames)
        self.links = tuple(links)
        self._moving = [link for link in links if link.fixed is None]
        self._parts: list[Rigid | _Step] = []
        for is_static, group in groupby(steps, lambda step: step.link.fixed is not None):
            if is_static:
                self._parts.append(reduce(rigid.compose, (step.at(0) for step in group)))
            else:
                self._parts += group

    def at(self, stamp_ns: int) -> Rigid:
        """Return motion target_from_source at a stamp at which all links are known."""
        motions = [part.at(stamp_ns) if isinstance(part, _Step) else part for part in self._parts]
        return reduce(rigid.compose, motions or [_IDENTITY])

    def lacking(self, stamp_ns: int) -> tuple[Coverage, Link | None]:
        """Return whether it is known at a stamp, and which link is not: one that will not come before one that may."""
        found = [(link.coverage(stamp_ns), link) for link in self._moving]
        lacking = [(coverage, link) for coverage, link in found if coverage is not Coverage.KNOWN]
        return min(lacking, key=lambda pair: pair[0] is Coverage.NOT_YET, default=(Coverage.KNOWN, None))

    def ends_first(self) -> Link | None:
        """Return the dynamic link whose last reading is the oldest; None if all are static."""
        return min(self._moving, key=lambda link: link.stamps_ns[-1], default=None)
