"""The transform buffer of a running robot, tolerant to a clock that is set back."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias, final

from gridslam.errors import ArgumentError
from gridslam.io.bags.ros_messages import StampedTransform
from gridslam.transforms import TransformBuffer

Warn: TypeAlias = Callable[[str, str], None]
"""Called with the kind of a problem, and the problem."""

_KEEP_S = 10.0
_MAX_PARENTS = 16  # of one frame
_SIMULTANEOUS_NS = 2_000_000_000  # readings with two parents within this count as simultaneous


@final
class JumpDetector:
    """Detects that stamps jump back and stay there: one stamp alone may be wrong, two are a clock that was set back.

    Parameters
    ----------
    jump_s : float, s
        Two stamps in a row that are this much older than the latest of their source are a jump.
    """

    def __init__(self, jump_s: float) -> None:
        self._jump_ns = round(jump_s * 1e9)
        self._strays: dict[object, int] = {}

    def detect(self, source: object, stamp_ns: int, latest_ns: int) -> bool | None:
        """Whether this is the second stamp of a jump; None if it is the first one, which may be wrong."""
        stray_ns = self._strays.pop(source, None)
        if stamp_ns >= latest_ns - self._jump_ns:
            return False
        if stray_ns is not None and 0 < stamp_ns - stray_ns <= self._jump_ns:
            return True
        self._strays[source] = stamp_ns
        return None


@final
class LiveTransforms:
    """Feeds a `TransformBuffer`; where the stamps of a link jump back and stay there, all dynamic links restart.

    Parameters
    ----------
    jump_s : float, s
        Two readings in a row that are this much older than the latest of their link are a jump.
    warn : callable
        Called with readings that are not valid transforms.

    Attributes
    ----------
    buffer : TransformBuffer
        The current buffer.
    """

    def __init__(self, jump_s: float, warn: Warn) -> None:
        self.buffer = TransformBuffer(_KEEP_S)
        self._jumps = JumpDetector(jump_s)
        self._warn = warn
        self._static: dict[tuple[str, str], StampedTransform] = {}
        self._latest_ns: dict[tuple[str, str], int] = {}
        self._parents: dict[str, dict[str, tuple[int, int] | None]] = {}  # of a child: first and last stamp

    def add(self, transforms: Iterable[StampedTransform], *, static: bool) -> None:
        """Add readings; those that are invalid, or that give a frame a second parent, are reported."""
        for transform in transforms:
            try:
                if static:
                    self._static[transform.parent, transform.child] = transform
                elif self._detect_jump(transform):
                    self._restart()
                self._add(transform, static)
                self._check_parents(transform, static)
                self._forget(transform)
            except (ArgumentError, OverflowError) as error:
                self._forget(transform)
                self._warn("transform refused", f"{transform.parent} <- {transform.child}: {error}")

    def _forget(self, transform: StampedTransform) -> None:
        """Forget a link that the buffer does not hold."""
        link = transform.parent, transform.child
        if link not in self.buffer:
            self._static.pop(link, None)
            self._latest_ns.pop(link, None)

    def newest_ns(self, parent: str) -> int | None:
        """Return the stamp of the latest dynamic reading with this parent; None if there is none."""
        return max((stamp_ns for (above, _), stamp_ns in self._latest_ns.items() if above == parent), default=None)

    def _add(self, transform: StampedTransform, static: bool) -> None:
        stamp_ns, parent, child, pose = transform
        self.buffer.add_quaternion(parent, child, stamp_ns, pose[:3], pose[3:], static)

    def _check_parents(self, transform: StampedTransform, static: bool) -> None:
        """Warn if a frame has two parents at a time."""
        stamp_ns, parent, child, _ = transform
        parents = self._parents.setdefault(child, {})
        before = parents.get(parent)
        first_ns = stamp_ns if before is None or stamp_ns - before[1] > _SIMULTANEOUS_NS else before[0]
        parents[parent] = None if static else (first_ns, stamp_ns)
        if len(parents) > _MAX_PARENTS:
            del parents[next(iter(parents))]
        for other, times in parents.items():
            is_now = static or times is None or first_ns <= times[1] <= stamp_ns + _SIMULTANEOUS_NS
            if other != parent and is_now:
                twice = f"{child} is published twice (in {parent} and in {other}): stop one of the two publishers"
                self._warn("two transforms", twice)

    def _detect_jump(self, transform: StampedTransform) -> bool:
        """Whether this is the second reading in a row from long before the latest."""
        stamp_ns = transform.stamp_ns
        link = transform.parent, transform.child
        latest_ns = self._latest_ns.get(link, stamp_ns)
        jumped = self._jumps.detect(link, stamp_ns, latest_ns)
        if jumped is False:
            self._latest_ns[link] = max(stamp_ns, latest_ns)
        return jumped is True

    def _restart(self) -> None:
        self.buffer = TransformBuffer(_KEEP_S)
        self._latest_ns.clear()
        self._parents.clear()
        for transform in self._static.values():
            self._add(transform, static=True)
