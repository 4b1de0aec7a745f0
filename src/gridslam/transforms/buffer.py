"""The transform buffer: stores the links of a log or a robot, and returns the pose of one frame in another.

It never extrapolates by itself (`extrapolate_planar` does on request); the error names the missing link.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError, GridslamError
from gridslam.geometry import rigid, se2
from gridslam.geometry.angles import wrap
from gridslam.geometry.rigid import Rigid
from gridslam.transforms.link import Coverage, Link
from gridslam.types import FloatArray, describe_duration

_IDENTITY: Rigid = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
_MOST_LINKS = 10_000  # 2.5 kB each; a fleet of 100 robots has as many
_MOST_NAMES = 8
_VELOCITY_NS = 50_000_000  # the velocity is that over this time, or between two readings if they are further apart
_MAX_SPEED = 10.0  # m/s and rad/s: faster than any robot


@final
class MissingTransform(GridslamError):  # noqa: N818 - the name states what is missing
    """A transform that was asked for is not known at its stamp.

    Attributes
    ----------
    link : str
        What is missing, without a time.
    coverage : Coverage
        Why; never KNOWN.
    apart_s : float, s
        From the stamp to the nearest reading of the missing link; infinite if the frames are not connected.
    """

    def __init__(
        self,
        target: str,
        source: str,
        stamp_ns: int,
        coverage: Coverage,
        reason: str,
        apart_s: float = np.inf,
    ) -> None:
        self.link = f"no transform from '{source}' to '{target}'"
        super().__init__(f"{self.link} at {stamp_ns / 1e9:.3f} s: {reason}")
        self.coverage = coverage
        self.apart_s = apart_s


@final
@checked
class TransformBuffer:
    """Links between frames, each over its last `keep_s` seconds; a frame with a leading "/" is the one without.

    Between two readings a link is interpolated, however far they are apart within `keep_s`. A static link holds at
    every stamp; one that comes as static and as dynamic is dynamic. Readings may come late and twice: the first one of
    a stamp stays, and of a static link the last. Where the stamps of a link jump back by more than `keep_s` and stay
    there, as in a log that was played twice, it restarts; a shorter jump leads to stamps that are known.

    Frames may form several trees, one for each robot. A frame has one parent, as in ROS: of several the first one,
    until it was silent for `keep_s` while another one spoke. There are at most 10,000 links.

    Parameters
    ----------
    keep_s : float, s
        Finite and > 0. Bounds the memory, and how long a reader can wait for a reading that comes late.
    """

    def __init__(self, keep_s: float = 10.0) -> None:
        if not 0.0 < keep_s < np.inf:
            raise ArgumentError("keep_s", "a finite time > 0 s", keep_s)
        self._keep_ns = round(keep_s * 1e9)
        self._links: dict[str, Link] = {}  # by the child

    def add_quaternion(
        self,
        parent: str,
        child: str,
        stamp_ns: int,
        translation: Sequence[float],
        xyzw: Sequence[float],
        static: bool = False,
    ) -> None:
        """Take one reading of a link; nothing happens where another parent has the child.

        Parameters
        ----------
        parent, child : str
            Frames.
        stamp_ns : int
            When, ns; of no matter for a static link.
        translation : (3,), m
            Position of the child in the parent.
        xyzw : (4,)
            Its orientation, a quaternion of norm 1.
        static : bool
            Whether it holds at all times.

        Raises
        ------
        ArgumentError
            A value is not finite, the quaternion is not of norm 1, or no tree can hold the link: of a frame to itself,
            of a frame without a name or to one below it, or one more than 10,000.
        """
        motion = rigid.from_quaternion(translation, xyzw)
        link = self._link(_bare(parent), _bare(child), stamp_ns)
        if link is None:
            return
        if static:
            link.fix(motion)
        else:
            link.add(stamp_ns, motion)

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray:
        """Transform target_from_source (4, 4) at a stamp in ns; raises MissingTransform where it is not known."""
        return rigid.to_matrix(self._motion(_bare(target), _bare(source), stamp_ns))

    def planar(self, target: str, source: str, stamp_ns: int) -> FloatArray:
        """Pose (3,) = [x m, y m, yaw rad] of `source` in `target` seen from above, as `rigid.planar` of `lookup`.

        Raises MissingTransform where it is not known, ArgumentError where the x axis of `source` is vertical.
        """
        x, y, yaw = rigid.planar(self._motion(_bare(target), _bare(source), stamp_ns))
        return np.array((x, y, wrap(yaw)))

    def extrapolate_planar(self, target: str, source: str, stamp_ns: int, most_s: float) -> FloatArray | None:
        """Return pose (3,) as of `planar` at a stamp after the last reading, with the velocity up to there.

        Parameters
        ----------
        target, source : str
            Frames.
        stamp_ns : int
            When, ns.
        most_s : float, s
            Longest time to extrapolate.

        Returns
        -------
        (3,) or None
            The motion of the last 50 ms, or of the last two readings, goes on. None if the last reading, or the one
            before that, is older than `most_s`, there are not two, or the velocity is no robot's.
        """
        steps = self._steps(_bare(target), _bare(source)) or []
        moving = [step.link for step in steps if step.link.fixed is None]
        end = min(moving, key=lambda link: link.stamps_ns[-1], default=None)
        if end is None or len(end.stamps_ns) < 2:
            return None
        stamps = end.stamps_ns
        before_ns = stamps[min(bisect_left(stamps, stamps[-1] - _VELOCITY_NS), len(stamps) - 2)]
        most_ns = most_s * 1e9
        if not (0 <= stamp_ns - stamps[-1] <= most_ns and stamps[-1] - before_ns <= most_ns):
            return None
        if any(link.coverage(before_ns) is not Coverage.KNOWN for link in moving):
            return None
        last = self.planar(target, source, stamps[-1])
        motion = se2.log(se2.between(self.planar(target, source, before_ns), last))
        velocity = motion / ((stamps[-1] - before_ns) * 1e-9)
        if np.abs(velocity).max() > _MAX_SPEED:
            return None
        return se2.compose(last, se2.exp(velocity * ((stamp_ns - stamps[-1]) * 1e-9)))

    def __contains__(self, link: tuple[str, str]) -> bool:
        """Return whether there is a link between two frames, parent and child."""
        parent, child = link
        found = self._links.get(_bare(child))
        return found is not None and found.parent == _bare(parent)

    def __len__(self) -> int:
        """Return the number of readings kept, a static link counting as one."""
        return sum(len(link) for link in self._links.values())

    def _link(self, parent: str, child: str, stamp_ns: int) -> Link | None:
        """Link between two frames, a new one where there is none; None where the child has another parent."""
        if parent == child or not parent or not child:
            raise ArgumentError("child", "two frames, each with a name", f"'{child}' in '{parent}'")
        link = self._links.get(child)
        if link is None or (link.parent != parent and link.fixed is None and link.ends_before(stamp_ns)):
            if child in self._above(parent):
                raise ArgumentError("child", "a tree of frames", f"'{child}' in '{parent}', which is below it")
            if len(self._links) >= _MOST_LINKS:
                raise ArgumentError("child", f"at most {_MOST_LINKS} frames", f"one more, '{child}'")
            link = self._links[child] = Link(parent, child, self._keep_ns)
        return link if link.parent == parent else None

    def _motion(self, target: str, source: str, stamp_ns: int) -> Rigid:
        steps = self._steps(target, source)
        if steps is None:
            frames = dict.fromkeys(frame for link in self._links.values() for frame in (link.parent, link.child))
            unknown = [frame for frame in (source, target) if frame not in frames]
            reason = (
                f"no link names {_list(unknown)}; the frames are {_list(list(frames))}"
                if unknown
                else f"the frames are not connected: above them are {_list(self._above(source))}, "
                f"and {_list(self._above(target))}"
            )
            raise MissingTransform(target, source, stamp_ns, Coverage.NOT_CONNECTED, reason)
        for coverage in (Coverage.TOO_EARLY, Coverage.NOT_YET):  # what will not come before what may
            for step in steps:
                if step.link.coverage(stamp_ns) is coverage:
                    raise _describe_missing(target, source, stamp_ns, steps, step.link)
        motion = _IDENTITY
        for step in steps:
            own = step.link.at(stamp_ns)
            motion = rigid.compose(motion, rigid.inverse(own) if step.up else own)
        return motion

    def _steps(self, target: str, source: str) -> list[_Step] | None:
        """Links from target to source; None where the frames are not connected."""
        up = self._above(target)
        down = self._above(source)
        shared = next((frame for frame in up if frame in down), None)
        if shared is None:
            return None
        steps = [_Step(self._links[frame], True) for frame in up[: up.index(shared)]]
        return steps + [_Step(self._links[frame], False) for frame in reversed(down[: down.index(shared)])]

    def _above(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on up to the root."""
        found = [frame]
        while (link := self._links.get(found[-1])) is not None:
            found.append(link.parent)
        return found


class _Step(NamedTuple):
    """A link of a chain, which may lead up, from child to parent."""

    link: Link
    up: bool


def _describe_missing(target: str, source: str, stamp_ns: int, steps: Sequence[_Step], link: Link) -> MissingTransform:
    """Return the error of a link that does not reach to a stamp."""
    frames = [target, *(step.link.parent if step.up else step.link.child for step in steps)]
    coverage = link.coverage(stamp_ns)
    late = coverage is Coverage.NOT_YET
    known_ns = link.stamps_ns[-1 if late else 0]
    apart_s = abs(known_ns - stamp_ns) / 1e9
    reason = (
        f"of the chain {' <- '.join(frames)} the link {link.parent} <- {link.child} is known only "
        f"{'until' if late else 'from'} {known_ns / 1e9:.3f} s, "
        f"{describe_duration(apart_s)} {'before' if late else 'after'}"
    )
    return MissingTransform(target, source, stamp_ns, coverage, reason, apart_s)


def _bare(frame: str) -> str:
    return frame.lstrip("/")


def _list(frames: Sequence[str]) -> str:
    """List frames: quoted, and if there are many, the first ones and how many more."""
    shown = ", ".join(f"'{frame}'" for frame in frames[:_MOST_NAMES])
    more = len(frames) - _MOST_NAMES
    return f"{shown} and {more} more" if more > 0 else shown or "none"
