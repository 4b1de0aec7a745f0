"""A first look into a bag: frames of its lasers and its odometry, the tree of links, and the choice that follows."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, TypeAlias, final

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry import rigid
from gridslam.geometry.angles import find_wrong_beam_angles
from gridslam.geometry.rigid import Rigid
from gridslam.io.bags.encoder import MessageEncoder, MessageError
from gridslam.io.bags.ros_messages import (
    OdometryMessage,
    ScanMessage,
    StampedTransform,
    decode_odometry,
    decode_scan,
    decode_transforms,
    kind_of,
)
from gridslam.io.bags.source import BagSource
from gridslam.io.selection import LogOptions

_LOOK_NS = 10_000_000_000  # of the log, at least: transforms are published at 10 Hz and more often, static ones at once
_MOVED_M = 0.005  # a mounting that has moved by less has not: rounding, a calibration's last digits
_MOVED_RAD = 0.01
_USUAL = "/scan"
_TRUTH = re.compile(r"truth|ground|(?:^|[/_])gt(?:$|[/_])", re.IGNORECASE)
_ABOVE_BASE = re.compile(r"odom|^map$|^world$|^earth$", re.IGNORECASE)
_ODOMETRY_FRAME = re.compile(r"odom", re.IGNORECASE)
_BASES = ("base_link", "base_footprint", "base", "base_frame", "base_stabilized")


Decoded: TypeAlias = ScanMessage | OdometryMessage | list[StampedTransform]

_DECODERS: Mapping[str, Callable[[bytes, MessageEncoder], Decoded]] = {
    "scan": decode_scan,
    "odometry": decode_odometry,
    "transforms": decode_transforms,
}


class Step(NamedTuple):
    """One link, (parent, child), of a way from frame to frame, and whether it is passed from parent to child."""

    link: tuple[str, str]
    down: bool


@final
@dataclass(slots=True)
class TopicInfo:
    """A topic of scans or odometry: frames of its first messages, whether they are stamped, and their faults."""

    frame: str
    child_frame: str
    stamped: bool = False
    messages: int = 0
    problems: Counter[str] = field(default_factory=Counter)

    @property
    def problem(self) -> str:
        """The fault of most of the messages; empty where there is none."""
        found, count = next(iter(self.problems.most_common(1)), ("", 0))
        return found if 2 * count > self.messages else ""


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
    moves : bool
        Whether a later one is another by more than 5 mm or 0.01 rad.
    """

    topic: str
    pose: Rigid
    moves: bool = False


@final
@dataclass(slots=True)
class Survey:
    """Content of a bag: topics of scans and odometry by name, links by parent and child, invalid readings."""

    scans: dict[str, TopicInfo] = field(default_factory=dict)
    odometry: dict[str, TopicInfo] = field(default_factory=dict)
    links: dict[tuple[str, str], LinkInfo] = field(default_factory=dict)
    unusable: Counter[str] = field(default_factory=Counter)
    _parents: dict[str, str] = field(default_factory=dict)

    def ancestors(self, frame: str) -> list[str]:
        """Return the frame, its parent, the parent's parent, up to the root."""
        found = [frame]
        while (parent := self._parents.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def names(self, frame: str) -> bool:
        """Return whether a link names the frame."""
        return any(frame in ends for ends in self.links)

    def way(self, target: str, source: str) -> list[Step] | None:
        """Links that join two frames, from the target on; None where they are not connected."""
        up = self.ancestors(target)
        down = self.ancestors(source)
        shared = next((frame for frame in up if frame in down), None)
        if shared is None:
            return None
        steps = [Step((parent, child), False) for child, parent in pairwise(up[: up.index(shared) + 1])]
        below = down[: down.index(shared) + 1]
        return steps + [Step((parent, child), True) for parent, child in pairwise(reversed(below))]

    def add(self, topic: str, transform: StampedTransform) -> None:
        """Add a transform."""
        pose = self.pose(transform.pose, f"{topic}: {transform.parent} -> {transform.child}")
        if pose is None or transform.parent == transform.child:
            return
        link = self.links.get((transform.parent, transform.child))
        if link is None:
            link = LinkInfo(topic, pose)
            self.links[transform.parent, transform.child] = link
            self._parents.setdefault(transform.child, transform.parent)
        elif pose != link.pose:
            link.moves = link.moves or differs(link.pose, pose)

    def pose(self, values: Rigid, what: str) -> Rigid | None:
        """Return the pose of a message, or None, counted, if it is invalid."""
        try:
            return rigid.from_quaternion(values[:3], values[3:])
        except ArgumentError:
            self.unusable[what] += 1
            return None


def differs(a: Rigid, b: Rigid) -> bool:
    """Return whether two poses differ by more than 5 mm or 0.01 rad."""
    x, y, z, i, j, k, _ = rigid.compose(rigid.inverse(a), b)
    return x * x + y * y + z * z > _MOVED_M**2 or 4 * (i * i + j * j + k * k) > _MOVED_RAD**2


def decoded_messages(source: BagSource, kinds: Mapping[str, str]) -> Iterator[tuple[int, str, Decoded]]:
    """Yield time of recording in ns, topic and message of the topics in `kinds`, in the order of recording.

    Raises InputError, which names the message, where one does not match the type of its topic.
    """
    for time_ns, name, data in source.messages(kinds):
        try:
            message = _DECODERS[kinds[name]](data, source.encoder)
        except MessageError as error:
            problem = f"a message of {name} recorded at {time_ns / 1e9:.3f} s is no {source.topics[name].type}: {error}"
            raise InputError(source.path, problem) from None
        yield time_ns, name, message


def survey(source: BagSource) -> Survey:
    """Look into the first 10 s of a bag, and as far on as is needed to see every topic and the mounting of each laser.

    Raises InputError if the bag is damaged or a message does not match the type of its topic.
    """
    kinds = {name: kind_of(topic.type) for name, topic in source.topics.items() if topic.messages}
    found = Survey()
    _look(source, {name: kind for name, kind in kinds.items() if kind}, found, first=True)
    seen = {*found.scans, *found.odometry}
    unseen = {name: kind for name, kind in kinds.items() if kind in ("scan", "odometry") and name not in seen}
    if not _connected(found):
        unseen |= {name: kind for name, kind in kinds.items() if kind == "transforms"}
    if unseen:
        _look(source, unseen, found, first=False)
    return found


def _connected(found: Survey) -> bool:
    """Whether the transforms lead from each laser to some other frame, or there are no transforms to wait for."""
    return all(len(found.ancestors(topic.frame)) > 1 for topic in found.scans.values())


def _complete(found: Survey, kinds: Mapping[str, str]) -> bool:
    seen = {*found.scans, *found.odometry}
    return _connected(found) and all(name in seen or kind == "transforms" for name, kind in kinds.items())


def _look(source: BagSource, kinds: Mapping[str, str], found: Survey, first: bool) -> None:
    """Read the topics: at first for 10 s, then until each of them has been seen and the lasers are connected."""
    until_ns: int | None = None
    for time_ns, name, message in decoded_messages(source, kinds):
        if until_ns is None:
            until_ns = time_ns + _LOOK_NS
        if first and time_ns > until_ns:
            return
        _note(found, name, message)
        if not first and _complete(found, kinds):
            return


def _note(found: Survey, name: str, message: Decoded) -> None:
    """Take in a message."""
    if isinstance(message, list):
        for transform in message:
            found.add(name, transform)
        return
    if isinstance(message, ScanMessage):
        topic = found.scans.setdefault(name, TopicInfo(message.frame, ""))
        if problem := find_scan_problem(message):
            topic.problems[problem] += 1
    else:
        topic = found.odometry.setdefault(name, TopicInfo(message.frame, message.child_frame))
        found.pose(message.pose, name)
    topic.stamped = topic.stamped or message.stamp_ns != 0
    topic.messages += 1


def find_scan_problem(message: ScanMessage) -> str:
    """Describe why no map can be made of such a scan; empty where nothing is wrong."""
    beams = len(message.ranges)
    if not beams and message.intensities:
        return f"expected ranges, got none, and {message.intensities} intensities: record the ranges"
    return _find_wrong_angles(message.angle_min, message.angle_increment, beams, message.angle_max)


_find_wrong_angles = lru_cache(maxsize=64)(find_wrong_beam_angles)  # of most lasers all scans have the same


@final
@dataclass(frozen=True, slots=True)
class Choice:
    """The part of a bag that is read.

    Attributes
    ----------
    scans : tuple of str
        Topics of the lasers.
    odometry : str
        Topic of the odometry; empty where it is taken from the transforms, or there is none.
    odometry_frame : str
        Frame in which the odometry is; empty where there is none.
    odometry_child : str
        Child frame of the odometry topic.
    base_frame : str
        Frame whose poses the log has.
    remarks : tuple of str
        What was decided that the user may want to know.
    """

    scans: tuple[str, ...]
    odometry: str
    odometry_frame: str
    odometry_child: str
    base_frame: str
    remarks: tuple[str, ...]


def choose(source: BagSource, seen: Survey, options: LogOptions) -> Choice:
    """Choose lasers, odometry and frames.

    The odometry comes from a topic of nav_msgs/Odometry if there is one that is not ground truth: it is what its source
    measured, at its own stamps, also in logs without transforms. Where `options.odometry_frame` is given, or there is
    no such topic, it comes from the transforms.

    Raises
    ------
    InputError
        There are no scans, no such topics or frames as the options name, or several of which one must be chosen.
    """
    remarks: list[str] = []
    scans = _scans(source, seen, options, remarks)
    for name in scans:
        if problem := seen.scans[name].problem:
            raise InputError(source.path, f"the scans of {name}: {problem}")
    odometry = "" if options.no_odometry else _odometry_topic(source, seen, options, remarks)
    above = [seen.ancestors(seen.scans[name].frame) for name in scans]
    if odometry:
        frame = seen.odometry[odometry].frame
        child = _child(seen, odometry, above, remarks)
    else:
        frame = "" if options.no_odometry else (options.odometry_frame or _odometry_frame(seen, above)).lstrip("/")
        child = _below(seen, frame, above) or _base_above(seen, above[0][0]) or "base_link"
    base = (options.base_frame or child).lstrip("/")
    if not odometry:
        child = base
    _check_joined(source.path, seen, base if odometry or not frame else frame, child)
    for frames in above:
        if len(frames) > 1 and seen.names(base):
            _check_joined(source.path, seen, base, frames[0])
    return Choice(scans, odometry, frame, child, base, tuple(remarks))


def _child(seen: Survey, odometry: str, above: list[list[str]], remarks: list[str]) -> str:
    """Child frame of the odometry; if it is empty or unknown to the transforms, the base."""
    topic = seen.odometry[odometry]
    base = next((base for frames in above if (base := _base_above(seen, frames[0]))), "")
    child = "" if topic.child_frame == topic.frame else topic.child_frame
    if child and (seen.names(child) or not base):
        return child
    found = base or "base_link"
    if seen.links:
        named = f"the child frame {child}, which no transform names" if child else "no child frame"
        remarks.append(f"{odometry} has {named}: {found} is used (--base-frame)")
    return found


def _scans(source: BagSource, seen: Survey, options: LogOptions, remarks: list[str]) -> tuple[str, ...]:
    empty = [name for name, topic in sorted(source.topics.items()) if kind_of(topic.type) == "scan"]
    if not seen.scans and empty:
        raise InputError(source.path, f"expected scans on {', '.join(empty)}, got no message of it")
    if not seen.scans:
        there = ", ".join(f"{name} ({topic.type})" for name, topic in sorted(source.topics.items())) or "no topics"
        raise InputError(source.path, f"expected scans (sensor_msgs/LaserScan), got {there}")
    if options.scan_topics:
        wanted = tuple(dict.fromkeys("/" + name.removeprefix("/") for name in options.scan_topics))
        for name in wanted:
            if name not in seen.scans:
                raise InputError(source.path, f"expected scans on {name}, got scans on {', '.join(seen.scans)} alone")
        return wanted
    names = sorted(seen.scans)
    if len(names) > 1:
        problem = _why_not_together(seen, names)
        if problem and _USUAL not in names:
            raise InputError(source.path, f"{problem}: choose with --scan TOPIC among {', '.join(names)}")
        if problem:
            others = ", ".join(name for name in names if name != _USUAL)
            remarks.append(f"{others} left out, {_USUAL} taken: {problem} (--scan TOPIC takes others, too)")
            names = [_USUAL]
    return tuple(names)


def _why_not_together(seen: Survey, names: Sequence[str]) -> str:
    """Return why these cannot be taken for different lasers, fixed on one robot; empty where they can."""
    frames = {name: seen.scans[name].frame for name in names}
    bases = {name: _base_above(seen, frame) for name, frame in frames.items()}
    for name, base in bases.items():
        if not base:
            return f"there are several lasers, and the mounting of {name} ({frames[name]}) is unknown (no transform)"
        if any(seen.links[step.link].moves for step in seen.way(base, frames[name]) or ()):
            return f"there are several lasers, and {name} moves on the robot"
    if len(set(bases.values())) > 1:
        return f"there are lasers of several robots ({', '.join(f'{name} on {base}' for name, base in bases.items())})"
    if len(set(frames.values())) < len(names):
        return "there are several topics of one laser (in one frame)"
    return ""


def _odometry_topic(source: BagSource, seen: Survey, options: LogOptions, remarks: list[str]) -> str:
    if options.odometry_topic:
        name = "/" + options.odometry_topic.removeprefix("/")
        if name not in seen.odometry:
            there = ", ".join(seen.odometry) or "none"
            raise InputError(source.path, f"expected odometry (nav_msgs/Odometry) on {name}; topics of it: {there}")
        return name
    if options.odometry_frame:
        return ""
    names = [name for name in sorted(seen.odometry) if not _TRUTH.search(name)]
    left = [name for name in sorted(seen.odometry) if name not in names]
    if left:
        remarks.append(f"{', '.join(left)} not used: by its name it is ground truth (--odom TOPIC takes it)")
    if len(names) > 1:
        names = [name for name in names if _last(name) == "odom"] or names
    if len(names) > 1:
        problem = f"there are several odometries: choose with --odom TOPIC among {', '.join(names)}"
        raise InputError(source.path, problem)
    return names[0] if names else ""


def _odometry_frame(seen: Survey, above: list[list[str]]) -> str:
    """Parent frame of the odometry in the transforms: above the lasers, or else the only one there is."""
    for frames in above:
        for frame in frames[1:]:
            if _ODOMETRY_FRAME.search(_last(frame)):
                return frame
    found = {parent for parent, _ in seen.links if _ODOMETRY_FRAME.search(_last(parent))}
    return found.pop() if len(found) == 1 else ""


def _below(seen: Survey, odometry_frame: str, above: list[list[str]]) -> str:
    """Return the base: the child of the odometry frame, between it and a laser if there is one."""
    if not odometry_frame:
        return ""
    for frames in above:
        if odometry_frame in frames[1:]:
            return frames[frames.index(odometry_frame) - 1]
    children = [child for parent, child in seen.links if parent == odometry_frame]
    named = [child for base in _BASES for child in children if _last(child) == base]
    return (named or children or [""])[0]


def _base_above(seen: Survey, frame: str) -> str:
    """Return the base that a laser is mounted on, by the transforms; empty if unknown."""
    frames = seen.ancestors(frame)
    if len(frames) == 1:
        return ""
    for place, name in enumerate(frames):
        if place and _ABOVE_BASE.search(_last(name)):
            return frames[place - 1]
    named = [name for name in frames if _last(name) in _BASES]
    return (named or frames)[-1]


def _check_joined(path: Path, seen: Survey, target: str, source: str) -> None:
    """Refuse a chain of transforms with a hole."""
    if seen.way(target, source) is not None:
        return
    trees = [" <- ".join(reversed(seen.ancestors(frame))) for frame in (target, source)]
    problem = f"no transform joins the frames {target} and {source} (there are the chains {trees[0]} and {trees[1]})"
    raise InputError(path, f"{problem}: choose with --base-frame, --odom-frame, or --no-odometry")


def _last(name: str) -> str:
    return name.rpartition("/")[2]
