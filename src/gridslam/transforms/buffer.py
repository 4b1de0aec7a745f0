"""The transform buffer: stores the links of a log or a robot, and returns the pose of one frame in another.

It never extrapolates by itself (`extrapolate_planar` does on request); the error names the missing link.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError, GridslamError
from gridslam.geometry import rigid, se2
from gridslam.geometry.angles import wrap
from gridslam.geometry.rigid import Rigid
from gridslam.transforms.link import Chain, Coverage, Link
from gridslam.types import describe_duration

FloatArray = NDArray[np.float64]

_MAX_CHAINS = 1000
_MAX_LINKS = 10_000  # 2.5 kB each; a fleet of 100 robots has as many
_MAX_NAMES = 8
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

    Frames may form several trees, one for each robot. A frame may have several parents, by error or because it was
    handed over: all links stand side by side, and of several ways the one of fewest links is taken, and of those the
    same one there and back. Another is taken only where a link of it does not reach back to the stamp, or was silent
    for `keep_s` while others spoke.

    Parameters
    ----------
    keep_s : float, s
        Finite and > 0. Bounds the memory, and how long a reader can wait for a reading that comes late.
    max_links : int, >= 16
        Most links; of more than that those expire that were not used, the oldest first and static ones last.

    Attributes
    ----------
    expired : int
        Number of links that have expired.
    """

    def __init__(self, keep_s: float = 10.0, max_links: int = _MAX_LINKS) -> None:
        if not 0.0 < keep_s < np.inf:
            raise ArgumentError("keep_s", "a finite time > 0 s", keep_s)
        self.expired = 0
        self._max_links = max_links
        self._used: set[Link] = set()  # of chains that were forgotten last
        self._keep_ns = round(keep_s * 1e9)
        self._links: dict[tuple[str, str], Link] = {}
        self._around: dict[str, list[Link]] = {}
        self._chains: dict[tuple[str, str], Chain | None] = {}
        self._has_cycles = False

    def add_quaternion(
        self,
        parent: str,
        child: str,
        stamp_ns: int,
        translation: Sequence[float],
        xyzw: Sequence[float],
        static: bool = False,
    ) -> None:
        """Take one reading of a link.

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
            or of a frame without a name.
        """
        motion = rigid.from_quaternion(translation, xyzw)
        link = self._link(_bare(parent), _bare(child))
        changed = link.fix(motion) if static else link.add(stamp_ns, motion)
        if changed:
            self._forget_chains()

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray:
        """Transform target_from_source (4, 4) at a stamp in ns; raises MissingTransform where it is not known."""
        return rigid.to_matrix(self._motion(_bare(target), _bare(source), stamp_ns))

    def planar(self, target: str, source: str, stamp_ns: int) -> FloatArray:
        """Pose (3,) = [x m, y m, yaw rad] of `source` in `target` seen from above, as `se3.to_planar` of `lookup`.

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
        target, source = _bare(target), _bare(source)
        chain = self._chain_at(target, source, stamp_ns)
        if chain is None or (end := chain.ends_first()) is None or len(end.stamps_ns) < 2:
            return None
        stamps = end.stamps_ns
        before_ns = stamps[min(bisect_left(stamps, stamps[-1] - _VELOCITY_NS), len(stamps) - 2)]
        most_ns = most_s * 1e9
        if not (0 <= stamp_ns - stamps[-1] <= most_ns and stamps[-1] - before_ns <= most_ns):
            return None
        if chain.lacking(before_ns)[1] is not None:
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
        return (_bare(parent), _bare(child)) in self._links

    def __len__(self) -> int:
        """Return the number of readings kept, a static link counting as one."""
        return sum(len(link) for link in self._links.values())

    def _link(self, parent: str, child: str) -> Link:
        """Link between two frames, a new one where there is none."""
        link = self._links.get((parent, child))
        if link is None:
            if parent == child or not parent or not child:
                raise ArgumentError("child", "two frames, each with a name", f"'{child}' in '{parent}'")
            if len(self._links) >= self._max_links:
                self._expire()
            if parent in self._around and child in self._around:
                self._has_cycles |= child in self._reach(parent)
                self._forget_chains()
            else:  # a leaf or a root leaves the chains of others as they are
                self._chains = {key: chain for key, chain in self._chains.items() if chain is not None}
            link = self._links[parent, child] = Link(parent, child, self._keep_ns)
            for frame in (parent, child):
                self._around.setdefault(frame, []).append(link)
        return link

    def _forget_chains(self) -> None:
        if self._chains:
            self._used = self._find_used()
            self._chains.clear()

    def _find_used(self) -> set[Link]:
        return {link for chain in self._chains.values() if chain is not None for link in chain.links}

    def _expire(self) -> None:
        """Drop an eighth of the links: those that no chain uses, the oldest first, dynamic ones before static ones."""
        used = self._used | self._find_used()
        unused = [link for link in self._links.values() if link not in used] or list(self._links.values())
        unused.sort(key=lambda link: link.fixed is not None)
        for link in unused[: self._max_links // 8]:
            del self._links[link.parent, link.child]
            for frame in (link.parent, link.child):
                self._around[frame].remove(link)
                if not self._around[frame]:
                    del self._around[frame]
            self.expired += 1
        self._chains = {key: chain for key, chain in self._chains.items() if chain is not None}

    def _motion(self, target: str, source: str, stamp_ns: int) -> Rigid:
        chain = self._chain_at(target, source, stamp_ns)
        if chain is None:
            unknown = [frame for frame in (source, target) if frame not in self._around]
            if unknown:
                reason = f"no link names {_list(unknown)}; the frames are {_list(list(self._around))}"
            else:
                source_tree = _list(list(self._reach(source)))
                target_tree = _list(list(self._reach(target)))
                reason = f"the frames are not connected: {source_tree} are one tree, {target_tree} another"
            raise MissingTransform(target, source, stamp_ns, Coverage.NOT_CONNECTED, reason)
        coverage, link = chain.lacking(stamp_ns)
        if link is None:
            return chain.at(stamp_ns)
        late = coverage is Coverage.NOT_YET
        known_ns = link.stamps_ns[-1 if late else 0]
        apart_s = abs(known_ns - stamp_ns) / 1e9
        apart = f"{describe_duration(apart_s)} {'before' if late else 'after'}"
        raise MissingTransform(
            target,
            source,
            stamp_ns,
            coverage,
            f"of the chain {' <- '.join(chain.frames)} the link {link.parent} <- {link.child} "
            f"is known only {'until' if late else 'from'} {known_ns / 1e9:.3f} s, {apart}",
            apart_s,
        )

    def _chain_at(self, target: str, source: str, stamp_ns: int) -> Chain | None:
        """Chain of fewest links, or the one that replaced it at this stamp; None where the frames are not connected."""
        key = target, source
        if key not in self._chains:
            if len(self._chains) >= _MAX_CHAINS:
                self._forget_chains()
            self._chains[key] = self._find_chain(target, source)
        chain = self._chains[key]
        if chain is None or not self._has_cycles or chain.lacking(stamp_ns)[0] is Coverage.KNOWN:
            return chain
        latest = max((link.stamps_ns[-1] for link in self._links.values() if link.stamps_ns), default=stamp_ns)

        def is_alive(link: Link) -> bool:
            coverage = link.coverage(stamp_ns)
            silent = coverage is Coverage.NOT_YET and link.stamps_ns[-1] < latest - self._keep_ns
            return coverage is not Coverage.TOO_EARLY and not silent

        return self._find_chain(target, source, is_alive) or chain

    def _find_chain(
        self, target: str, source: str, is_alive: Callable[[Link], bool] = lambda link: True
    ) -> Chain | None:
        """Chain of fewest links; None where the frames are not connected."""
        end, begin = sorted((target, source))  # of several ways the same one, there and back
        reached = self._reach(begin, is_alive)
        if end not in reached:
            return None
        links = []
        frame = end
        while (step := reached[frame]) is not None:
            frame, link = step
            links.append(link)
        return Chain(target, links if target == end else links[::-1])

    def _reach(
        self, source: str, is_alive: Callable[[Link], bool] = lambda link: True
    ) -> dict[str, tuple[str, Link] | None]:
        """Frames connected with one, itself first, each with the one before and the link between, breadth first."""
        reached: dict[str, tuple[str, Link] | None] = {source: None}
        queue = [source]
        for frame in queue:
            for link in self._around.get(frame, ()):
                other = link.child if link.parent == frame else link.parent
                if other not in reached and is_alive(link):
                    reached[other] = frame, link
                    queue.append(other)
        return reached


def _bare(frame: str) -> str:
    return frame.lstrip("/")


def _list(frames: Sequence[str]) -> str:
    """List frames: quoted, and if there are many, the first ones and how many more."""
    shown = ", ".join(f"'{frame}'" for frame in frames[:_MAX_NAMES])
    more = len(frames) - _MAX_NAMES
    return f"{shown} and {more} more" if more > 0 else shown or "none"
