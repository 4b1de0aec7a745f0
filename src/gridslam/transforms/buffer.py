"""The transform buffer: stores the links of a log or a robot, and returns the pose of one frame in another.

It never extrapolates; the error names the missing link.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ArgumentError
from gridslam.geometry import rigid
from gridslam.geometry.angles import wrap
from gridslam.geometry.rigid import Rigid
from gridslam.transforms.chain import Chain
from gridslam.transforms.link import Link, LinkStatistics
from gridslam.transforms.missing import Coverage, MissingTransform, named

__all__ = ["TransformBuffer"]

FloatArray = NDArray[np.float64]

_CHAINS_KEPT = 1000


@final
class TransformBuffer:
    """Links between frames, each over its last `keep_s` seconds; a frame with a leading "/" is the one without.

    Between two readings a link is interpolated, however far they are apart within `keep_s`. A static link holds at
    every stamp; one that comes as static and as dynamic is dynamic. Readings may come late and twice: see
    `LinkStatistics`. Where the stamps of a link jump back by more than `keep_s` and stay there, as in a log that was
    played twice, it restarts; a shorter jump leads to stamps that are known, and the first value there stays.

    Frames may form several trees, one for each robot. A frame may have several parents, by error or because it was
    handed over: all links stand side by side, and of several ways the one of fewest links is taken, and of those the
    same one there and back. Another is taken only where a link of it does not reach back to the stamp, or was silent
    for `keep_s` while others spoke.

    Parameters
    ----------
    keep_s : float, s
        Finite and > 0. Bounds the memory, and how long a reader can wait for a reading that comes late.

    Attributes
    ----------
    refused : Counter of str
        Links that no tree can hold, left out: of a frame to itself, of a frame without a name.
    ambiguous : list of (str, str)
        Parent and child of links that joined frames which were joined already: cycles and second parents.
    """

    def __init__(self, keep_s: float = 10.0) -> None:
        if not 0.0 < keep_s < np.inf:
            raise ArgumentError("keep_s", "a finite time > 0 s", keep_s)
        self.refused: Counter[str] = Counter()
        self.ambiguous: list[tuple[str, str]] = []
        self._keep_ns = round(keep_s * 1e9)
        self._links: dict[tuple[str, str], Link] = {}
        self._around: dict[str, list[Link]] = {}
        self._spelled: dict[tuple[str, str], Link] = {}  # by the names as they were given
        self._chains: dict[tuple[str, str], Chain | None] = {}

    def add(
        self,
        parent: str,
        child: str,
        stamp_ns: int,
        parent_from_child: ArrayLike,
        static: bool = False,
        publisher: str = "",
    ) -> None:
        """Take one reading of a link.

        Parameters
        ----------
        parent, child : str
            Frames.
        stamp_ns : int
            When, ns; of no matter for a static link.
        parent_from_child : (4, 4) float64
            Homogeneous transform, m.
        static : bool
            Whether it holds at all times.
        publisher : str, optional
            Name of the publisher, for the statistics.

        Raises
        ------
        ArgumentError
            If the transform is not rigid.
        """
        self._add(parent, child, stamp_ns, rigid.from_matrix(parent_from_child), static, publisher)

    def add_quaternion(
        self,
        parent: str,
        child: str,
        stamp_ns: int,
        translation: Sequence[float],
        xyzw: Sequence[float],
        static: bool = False,
        publisher: str = "",
    ) -> None:
        """Take a reading as `add` does, of a translation (3,) in m and a quaternion (4,) as they stand in a message.

        Five times faster than by way of a matrix. Raises ArgumentError if a value is not finite or the quaternion is
        not of norm 1.
        """
        self._add(parent, child, stamp_ns, rigid.from_quaternion(translation, xyzw), static, publisher)

    def lookup(self, target: str, source: str, stamp_ns: int) -> FloatArray:
        """Transform target_from_source (4, 4) at a stamp in ns; raises MissingTransform where it is not known."""
        return rigid.to_matrix(self._motion(target, source, stamp_ns))

    def planar(self, target: str, source: str, stamp_ns: int) -> FloatArray:
        """Pose (3,) = [x m, y m, yaw rad] of `source` in `target` seen from above, as `se3.to_planar` of `lookup`.

        Raises MissingTransform where it is not known, ArgumentError where the x axis of `source` is vertical.
        """
        x, y, yaw = rigid.planar(self._motion(target, source, stamp_ns))
        return np.array((x, y, wrap(yaw)))

    def covers(self, target: str, source: str, stamp_ns: int) -> Coverage:
        """Whether `lookup` knows the transform, or a reader may wait for it."""
        chain = self._chain_at(target, source, stamp_ns)
        return Coverage.NOT_CONNECTED if chain is None else chain.lacking(stamp_ns)[0]

    def is_static(self, target: str, source: str) -> bool:
        """Whether the frames are joined, and by static links alone: the transform is then the same at every stamp."""
        chain = self._chain(target, source)
        return chain is not None and chain.fixed

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames, in the order in which they came."""
        return tuple(self._around)

    @property
    def links(self) -> dict[tuple[str, str], LinkStatistics]:
        """What was met at each link, by its parent and child."""
        return {ends: link.statistics for ends, link in self._links.items()}

    @property
    def several_parents(self) -> dict[str, tuple[str, ...]]:
        """Parents of each frame that has more than one."""
        parents: dict[str, list[str]] = {}
        for parent, child in self._links:
            parents.setdefault(child, []).append(parent)
        return {child: tuple(names) for child, names in parents.items() if len(names) > 1}

    def __len__(self) -> int:
        """Return the number of readings kept, a static link counting as one."""
        return sum(len(link) for link in self._links.values())

    def _add(self, parent: str, child: str, stamp_ns: int, motion: Rigid, static: bool, publisher: str) -> None:
        link = self._spelled.get((parent, child)) or self._link(parent, child)
        if link is None:
            return
        if publisher:
            link.statistics.publishers.add(publisher)
        if static:
            if link.fix(motion):
                self._chains.clear()
            return
        if link.fixed is not None:  # it moves after all
            link.fixed = None
            link.statistics.contradicted += 1
            self._chains.clear()
        link.add(stamp_ns, motion)

    def _link(self, parent: str, child: str) -> Link | None:
        """Link between frames as they are spelled, a new one where there is none; None where there cannot be one."""
        above, below = _bare(parent), _bare(child)
        if above == below or not above or not below:
            self.refused[f"'{below}' in '{above}'"] += 1
            return None
        link = self._links.get((above, below))
        if link is None:
            if above in self._around and below in self._around and self._way(above, below) is not None:
                self.ambiguous.append((above, below))
            link = self._links[above, below] = Link(above, below, self._keep_ns)
            for frame in (above, below):
                self._around.setdefault(frame, []).append(link)
            self._chains.clear()
        self._spelled[parent, child] = link
        return link

    def _motion(self, target: str, source: str, stamp_ns: int) -> Rigid:
        chain = self._chain_at(target, source, stamp_ns)
        motion = None if chain is None else chain.at(stamp_ns)
        if motion is None:
            raise self._missing(_bare(target), _bare(source), stamp_ns, chain)
        return motion

    def _chain(self, target: str, source: str) -> Chain | None:
        """Shortest chain, made once until a link is added."""
        key = target, source
        if key not in self._chains:
            if len(self._chains) >= _CHAINS_KEPT:
                self._chains.clear()
            links = self._way(_bare(target), _bare(source))
            self._chains[key] = None if links is None else Chain(_bare(target), links)
        return self._chains[key]

    def _chain_at(self, target: str, source: str, stamp_ns: int) -> Chain | None:
        """Shortest chain, or the one that replaced it at this stamp."""
        chain = self._chain(target, source)
        if chain is None or not self.ambiguous or chain.lacking(stamp_ns)[0] is Coverage.KNOWN:
            return chain
        latest = max((link.stamps_ns[-1] for link in self._links.values() if link.stamps_ns), default=stamp_ns)

        def alive(link: Link) -> bool:
            coverage = link.coverage(stamp_ns)
            silent = coverage is Coverage.NOT_YET and link.stamps_ns[-1] < latest - self._keep_ns
            return coverage is not Coverage.TOO_EARLY and not silent

        links = self._way(_bare(target), _bare(source), alive)
        return chain if links is None else Chain(_bare(target), links)

    def _way(self, target: str, source: str, alive: Callable[[Link], bool] | None = None) -> list[Link] | None:
        """Fewest links from one frame to another, breadth first; None where they are not connected."""
        if target == source:
            return []
        if target > source:  # of several ways the same one, there and back
            back = self._way(source, target, alive)
            return None if back is None else back[::-1]
        reached: dict[str, tuple[str, Link] | None] = {source: None}
        queue = deque([source])
        while queue:
            frame = queue.popleft()
            for link in self._around.get(frame, ()):
                other = link.child if link.parent == frame else link.parent
                if other in reached or not (alive is None or alive(link)):
                    continue
                reached[other] = frame, link
                if other == target:
                    return _traced(reached, target)
                queue.append(other)
        return None

    def _tree(self, frame: str) -> list[str]:
        """Frames connected with one, itself first."""
        tree = {frame: None}
        queue = deque([frame])
        while queue:
            for link in self._around[queue.popleft()]:
                for other in (link.parent, link.child):
                    if other not in tree:
                        tree[other] = None
                        queue.append(other)
        return list(tree)

    def _missing(self, target: str, source: str, stamp_ns: int, chain: Chain | None) -> MissingTransform:
        coverage, link = (Coverage.NOT_CONNECTED, None) if chain is None else chain.lacking(stamp_ns)
        if chain is None or link is None:
            unknown = [frame for frame in (source, target) if frame not in self._around]
            if unknown:
                reason = f"no link names {named(unknown)}; the frames are {named(self.frames)}"
            else:
                trees = named(self._tree(source)), named(self._tree(target))
                reason = f"the frames are not connected: {trees[0]} are one tree, {trees[1]} another"
            return MissingTransform(target, source, stamp_ns, coverage, reason)
        late = coverage is Coverage.NOT_YET
        known_ns = link.stamps_ns[-1 if late else 0]
        when = "until" if late else "from"
        apart = f"{abs(known_ns - stamp_ns) / 1e9:.3g} s {'before' if late else 'after'}"
        reason = (
            f"of the chain {' <- '.join(chain.frames)} the link {link.parent} <- {link.child} "
            f"is known only {when} {known_ns / 1e9:.3f} s, {apart}"
        )
        ends = link.parent, link.child
        return MissingTransform(target, source, stamp_ns, coverage, reason, chain=chain.frames, link=ends)


def _bare(frame: str) -> str:
    return frame.lstrip("/")


def _traced(reached: dict[str, tuple[str, Link] | None], target: str) -> list[Link]:
    """Links from the target back to where the search began."""
    links: list[Link] = []
    step = reached[target]
    while step is not None:
        frame, link = step
        links.append(link)
        step = reached[frame]
    return links
