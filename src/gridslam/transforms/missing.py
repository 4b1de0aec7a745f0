"""Whether a transform is known, and the error that states why it is not."""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import final

from gridslam.errors import GridslamError

__all__ = ["Coverage", "MissingTransform", "named"]

_NAMES_SHOWN = 8


class Coverage(Enum):
    """What is known of a transform at a stamp."""

    KNOWN = "known"
    NOT_YET = "after the last reading of a link: it may come"
    TOO_EARLY = "before the first reading of a link that is kept: it will not come"
    NOT_CONNECTED = "no chain of links joins the frames so far"


@final
class MissingTransform(GridslamError):  # noqa: N818 - the name states what is missing
    """A transform that was asked for is not known at its stamp.

    Attributes
    ----------
    target, source : str
        Frames: the transform would carry points from `source` to `target`.
    stamp_ns : int
        When.
    coverage : Coverage
        Why; never KNOWN.
    chain : tuple of str
        Frames from `target` to `source`; empty where they are not connected.
    link : (str, str) or None
        Parent and child of the link of the chain that lacks a reading.
    """

    def __init__(
        self,
        target: str,
        source: str,
        stamp_ns: int,
        coverage: Coverage,
        reason: str,
        *,
        chain: tuple[str, ...] = (),
        link: tuple[str, str] | None = None,
    ) -> None:
        super().__init__(f"no transform from '{source}' to '{target}' at {stamp_ns / 1e9:.3f} s: {reason}")
        self.target, self.source, self.stamp_ns = target, source, stamp_ns
        self.coverage, self.chain, self.link = coverage, chain, link


def named(frames: Sequence[str]) -> str:
    """List frames: quoted, and if there are many, the first ones and how many more."""
    shown = ", ".join(f"'{frame}'" for frame in frames[:_NAMES_SHOWN])
    more = len(frames) - _NAMES_SHOWN
    return f"{shown} and {more} more" if more > 0 else shown or "none"
