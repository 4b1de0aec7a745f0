"""Links that join two frames, composed as far as they never change."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from gridslam.geometry import rigid
from gridslam.geometry.rigid import Rigid
from gridslam.transforms.link import Link
from gridslam.transforms.missing import Coverage

__all__ = ["Chain"]

_IDENTITY: Rigid = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@final
class Chain:
    """The way from `target` over `links` to a source frame.

    Static links that follow each other are one motion. Valid until a link is added or a static one changes.
    """

    __slots__ = ("_head", "_steps", "frames")

    def __init__(self, target: str, links: Sequence[Link]) -> None:
        frames = [target]
        self._head: Rigid | None = None
        self._steps: list[tuple[Link, bool, Rigid | None]] = []  # dynamic link, whether it points up, what follows
        for link in links:
            up = link.child == frames[-1]
            frames.append(link.parent if up else link.child)
            if link.fixed is None:
                self._steps.append((link, up, None))
                continue
            motion = rigid.inverse(link.fixed) if up else link.fixed
            if self._steps:
                last, last_up, tail = self._steps[-1]
                self._steps[-1] = (last, last_up, motion if tail is None else rigid.compose(tail, motion))
            else:
                self._head = motion if self._head is None else rigid.compose(self._head, motion)
        self.frames = tuple(frames)

    @property
    def fixed(self) -> bool:
        """Whether no link of it moves."""
        return not self._steps

    def at(self, stamp_ns: int) -> Rigid | None:
        """Motion target_from_source at a stamp; None where a link is not known then."""
        motion = self._head
        for link, up, tail in self._steps:
            step = link.at(stamp_ns)
            if step is None:
                return None
            if up:
                step = rigid.inverse(step)
            motion = step if motion is None else rigid.compose(motion, step)
            if tail is not None:
                motion = rigid.compose(motion, tail)
        return _IDENTITY if motion is None else motion

    def lacking(self, stamp_ns: int) -> tuple[Coverage, Link | None]:
        """Whether it is known at a stamp, and which link is not: one that will not come before one that may."""
        late: Link | None = None
        for link, _, _ in self._steps:
            coverage = link.coverage(stamp_ns)
            if coverage is Coverage.TOO_EARLY:
                return coverage, link
            if coverage is Coverage.NOT_YET and late is None:
                late = link
        return (Coverage.KNOWN, None) if late is None else (Coverage.NOT_YET, late)
