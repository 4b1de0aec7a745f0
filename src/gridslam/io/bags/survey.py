"""A first look into a bag: which frames its lasers and its odometry have, and the tree of links between frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple, final

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry import rigid
from gridslam.geometry.rigid import Rigid
from gridslam.io.bags.ros_messages import (
    MessageError,
    OdometryMessage,
    StampedTransform,
    Wire,
    decode_odometry,
    decode_scan,
    decode_transforms,
    kind_of,
    wire_of_cdr,
    wire_of_ros1,
)
from gridslam.io.bags.source import BagSource

__all__ = ["LinkInfo", "Step", "Survey", "TopicInfo", "differs", "make_input_error", "survey"]

_LOOK_NS = 10_000_000_000  # of the log, at least: transforms are published at 10 Hz and more often, static ones at once
_SAMPLES = 200
_MOVED_M, _MOVED_RAD = 0.005, 0.01  # a mounting that has moved by less has not: rounding, a calibration's last digits


class Step(NamedTuple):
    """One link, (parent, child), of a way from frame to frame, and whether it is passed from parent to child."""

    link: tuple[str, str]
    down: bool


@final
@dataclass(slots=True)
class TopicInfo:
    """A topic of scans or odometry: frames of its first messages, and whether they are stamped."""

    frame: str
    child_frame: str
    first_stamp_ns: int
    samples: list[tuple[int, Rigid]] = field(default_factory=list)
    stamped: bool = False


@final
@dataclass(slots=True)
class LinkInfo:
    """A link of the tree of frames.

    Attributes
    ----------
    topic : str
        Topic of the transform.
    pose : Rigid
        The first one of the child in the parent.
    stamp_ns : int
        Its stamp.
    static : bool
        Whether it was published as static.
    moves : bool
        Whether a later one is another by more than 5 mm or 0.01 rad.
    samples : list of (int, Rigid)
        Stamps and poses of the first ones that are not static.
    """

    topic: str
    pose: Rigid
    stamp_ns: int
    static: bool
    moves: bool = False
    samples: list[tuple[int, Rigid]] = field(default_factory=list)


@final
@dataclass(slots=True)
class Survey:
    """What was seen: topics of scans and of odometry by name, links by parent and child, readings that are no pose."""

    scans: dict[str, TopicInfo] = field(default_factory=dict)
    odometry: dict[str, TopicInfo] = field(default_factory=dict)
    links: dict[tuple[str, str], LinkInfo] = field(default_factory=dict)
    unusable: Counter[str] = field(default_factory=Counter)
    _parents: dict[str, str] = field(default_factory=dict)

    def ancestors(self, frame: str) -> list[str]:
        """The frame, its parent, the parent's parent, up to the root."""
        found = [frame]
        while (parent := self._parents.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def names(self, frame: str) -> bool:
        """Whether a link names the frame."""
        return any(frame in ends for ends in self.links)

    def way(self, target: str, source: str) -> list[Step] | None:
        """Links that join two frames, from the target on; None where they are not connected."""
        up, down = self.ancestors(target), self.ancestors(source)
        shared = next((frame for frame in up if frame in down), None)
        if shared is None:
            return None
        steps = [Step((parent, child), False) for child, parent in pairwise(up[: up.index(shared) + 1])]
        below = down[: down.index(shared) + 1]
        return steps + [Step((parent, child), True) for parent, child in pairwise(reversed(below))]

    def add(self, topic: str, transform: StampedTransform, static: bool) -> None:
        """Add a transform."""
        pose = self.pose(transform.pose, f"{topic}: {transform.parent} -> {transform.child}")
        if pose is None or transform.parent == transform.child:
            return
        link = self.links.get((transform.parent, transform.child))
        if link is None:
            link = LinkInfo(topic, pose, transform.stamp_ns, static)
            self.links[transform.parent, transform.child] = link
            self._parents.setdefault(transform.child, transform.parent)
        elif pose != link.pose:
            link.moves = link.moves or differs(link.pose, pose)
        if not static and len(link.samples) < _SAMPLES:
            link.samples.append((transform.stamp_ns, pose))

    def pose(self, values: Rigid, what: str) -> Rigid | None:
        """The pose of a message, or None, counted, if it is invalid."""
        try:
            return rigid.from_quaternion(values[:3], values[3:])
        except ArgumentError:
            self.unusable[what] += 1
            return None


def differs(a: Rigid, b: Rigid) -> bool:
    """Whether two poses differ by more than 5 mm or 0.01 rad."""
    x, y, z, i, j, k, _ = rigid.compose(rigid.inverse(a), b)
    return x * x + y * y + z * z > _MOVED_M**2 or 4 * (i * i + j * j + k * k) > _MOVED_RAD**2


def make_input_error(source: BagSource, topic: str, time_ns: int, error: MessageError) -> InputError:
    """Name the message that cannot be decoded."""
    type_ = source.topics[topic].type
    return InputError(source.path, f"a message of {topic} recorded at {time_ns / 1e9:.3f} s is no {type_}: {error}")


def survey(source: BagSource) -> Survey:
    """Look into the first 10 s of a bag, and as far on as is needed to see every topic and the mounting of each laser.

    Raises InputError if the bag is damaged or a message does not match the type of its topic.
    """
    kinds = {name: kind_of(topic.type) for name, topic in source.topics.items() if topic.messages}
    found = Survey()
    _look(source, {name: kind for name, kind in kinds.items() if kind}, found, first=True)
    unseen = {name: kind for name, kind in kinds.items() if kind in ("scan", "odometry") and not _topic_of(found, name)}
    if not _connected(found):
        unseen |= {name: kind for name, kind in kinds.items() if kind == "transforms"}
    if unseen:
        _look(source, unseen, found, first=False)
    return found


def _topic_of(found: Survey, name: str) -> bool:
    return name in found.scans or name in found.odometry


def _connected(found: Survey) -> bool:
    """Whether the transforms lead from each laser to some other frame, or there are no transforms to wait for."""
    return all(len(found.ancestors(topic.frame)) > 1 for topic in found.scans.values())


def _complete(found: Survey, kinds: Mapping[str, str]) -> bool:
    return _connected(found) and all(_topic_of(found, name) or kind == "transforms" for name, kind in kinds.items())


def _look(source: BagSource, kinds: Mapping[str, str], found: Survey, first: bool) -> None:
    """Read the topics: at first for 10 s, then until each of them has been seen and the lasers are connected."""
    wire_of = wire_of_ros1 if source.is_ros1 else wire_of_cdr
    until_ns: int | None = None
    for time_ns, name, data in source.messages(kinds):
        if until_ns is None:
            until_ns = time_ns + _LOOK_NS
        if first and time_ns > until_ns:
            return
        try:
            new = _note(found, name, kinds[name], data, wire_of(data))
        except MessageError as error:
            raise make_input_error(source, name, time_ns, error) from None
        if not first and new and _complete(found, kinds):
            return


def _note(found: Survey, name: str, kind: str, data: bytes, wire: Wire) -> bool:
    """Process a message; return whether it may have added information."""
    if kind == "transforms":
        links = len(found.links)
        for transform in decode_transforms(data, wire):
            found.add(name, transform, name.endswith("tf_static"))
        return len(found.links) > links
    scan = kind == "scan"
    topics = found.scans if scan else found.odometry
    message = decode_scan(data, wire) if scan else decode_odometry(data, wire)
    new = name not in topics
    if new:
        child = message.child_frame if isinstance(message, OdometryMessage) else ""
        topics[name] = TopicInfo(message.frame, child, message.stamp_ns)
    topic = topics[name]
    topic.stamped = topic.stamped or message.stamp_ns != 0
    if isinstance(message, OdometryMessage) and len(topic.samples) < _SAMPLES:
        pose = found.pose(message.pose, name)
        if pose is not None:
            topic.samples.append((message.stamp_ns, pose))
    return new
