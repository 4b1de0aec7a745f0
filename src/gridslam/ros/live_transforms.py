"""The transform buffer of a running robot, whose clock may be set back."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

from gridslam.errors import ArgumentError
from gridslam.io.ros_messages import StampedTransform
from gridslam.ros.complaints import Complaints
from gridslam.transforms import TransformBuffer

__all__ = ["LiveTransforms"]

_KEEP_S = 10.0


@final
class LiveTransforms:
    """Feeds a `TransformBuffer`; where the stamps of a link jump back and stay there, all that moves begins anew.

    Parameters
    ----------
    jump_s : float, s
        What counts as a jump: two readings in a row so much before the link's latest.
    complain : Complaints
        Told of readings that are no transforms.

    Attributes
    ----------
    buffer : TransformBuffer
        The present one.
    """

    def __init__(self, jump_s: float, complain: Complaints) -> None:
        self.buffer = TransformBuffer(_KEEP_S)
        self._jump_ns = round(jump_s * 1e9)
        self._complain = complain
        self._static: dict[tuple[str, str], StampedTransform] = {}
        self._latest_ns: dict[tuple[str, str], int] = {}
        self._strays: dict[tuple[str, str], int] = {}

    def add(self, transforms: Iterable[StampedTransform], *, static: bool) -> None:
        """Take readings; those that are none are told."""
        for transform in transforms:
            try:
                if static:
                    self._static[transform.parent, transform.child] = transform
                elif self._jumped(transform):
                    self._renew()
                self._add(transform, static)
            except (ArgumentError, OverflowError) as error:
                self._static.pop((transform.parent, transform.child), None)
                self._complain("transform refused", f"{transform.parent} <- {transform.child}: {error}")

    def _add(self, transform: StampedTransform, static: bool) -> None:
        stamp_ns, parent, child, pose = transform
        self.buffer.add_quaternion(parent, child, stamp_ns, pose[:3], pose[3:], static)

    def _jumped(self, transform: StampedTransform) -> bool:
        """Whether this is the second reading in a row from long before the latest."""
        link, stamp_ns = (transform.parent, transform.child), transform.stamp_ns
        latest_ns = self._latest_ns.get(link, stamp_ns)
        if stamp_ns >= latest_ns - self._jump_ns:
            self._latest_ns[link] = max(stamp_ns, latest_ns)
            self._strays.pop(link, None)
            return False
        stray_ns = self._strays.get(link)
        self._strays[link] = stamp_ns
        return stray_ns is not None and 0 < stamp_ns - stray_ns <= self._jump_ns

    def _renew(self) -> None:
        self.buffer = TransformBuffer(_KEEP_S)
        self._latest_ns.clear()
        self._strays.clear()
        for transform in self._static.values():
            self._add(transform, static=True)
