"""Default choice of topics and frames of a bag."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from gridslam.errors import InputError
from gridslam.io.bags.ros_messages import kind_of
from gridslam.io.bags.source import BagSource
from gridslam.io.bags.survey import Survey
from gridslam.io.selection import LogOptions

__all__ = ["Choice", "choose"]

_TRUTH = re.compile(r"truth|ground|(?:^|[/_])gt(?:$|[/_])", re.IGNORECASE)
_ABOVE_BASE = re.compile(r"odom|^map$|^world$|^earth$", re.IGNORECASE)
_ODOMETRY_FRAME = re.compile(r"odom", re.IGNORECASE)
_BASES = ("base_link", "base_footprint", "base", "base_frame", "base_stabilized")
_AGREES_M = 0.02  # odometry and transforms of one source are equal but for interpolation


@final
@dataclass(frozen=True, slots=True)
class Choice:
    """What is read of a bag.

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
    odometry = "" if options.no_odometry else _odometry_topic(source, seen, options, scans, remarks)
    above = [seen.ancestors(seen.scans[name].frame) for name in scans]
    if odometry:
        frame, child = seen.odometry[odometry].frame, _child(seen, odometry, above, remarks)
    else:
        frame = "" if options.no_odometry else _bare(options.odometry_frame or _odometry_frame(seen, above))
        child = _below(seen, frame, above) or _base_above(seen, above[0][0]) or "base_link"
    base = _bare(options.base_frame or child)
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
        named = f"{child}, which no transform names" if child else "no frame"
        remarks.append(f"{odometry} has the child frame {named}: used as {found} (--base-frame)")
    return found


def _scans(source: BagSource, seen: Survey, options: LogOptions, remarks: list[str]) -> tuple[str, ...]:
    empty = [name for name, topic in sorted(source.topics.items()) if kind_of(topic.type) == "scan"]
    if not seen.scans and empty:
        raise InputError(source.path, f"expected scans on {_listed(empty)}, got no message of it")
    if not seen.scans:
        there = ", ".join(f"{name} ({topic.type})" for name, topic in sorted(source.topics.items())) or "no topics"
        raise InputError(source.path, f"expected scans (sensor_msgs/LaserScan), got {there}")
    if options.scan_topics:
        wanted = tuple(dict.fromkeys(_topic(name) for name in options.scan_topics))
        for name in wanted:
            if name not in seen.scans:
                raise InputError(source.path, f"expected scans on {name}, got scans on {_listed(seen.scans)} alone")
        return wanted
    names = sorted(seen.scans)
    if len(names) > 1:
        names = _still(seen, names, remarks)
    if len(names) > 1:
        problem = _why_not_one_robot(seen, names)
        if problem:
            raise InputError(source.path, f"{problem}: choose with --scan TOPIC among {_listed(names)}")
    return tuple(names)


def _still(seen: Survey, names: list[str], remarks: list[str]) -> list[str]:
    """Leave out lasers that tilt or turn on the robot, if there are others."""
    still = []
    for name in names:
        base = _base_above(seen, seen.scans[name].frame)
        way = seen.way(base, seen.scans[name].frame) if base else None
        if not any(seen.links[step.link].moves for step in way or ()):
            still.append(name)
    if still and len(still) < len(names):
        moving = _listed(name for name in names if name not in still)
        remarks.append(f"{moving} left out: this laser moves on the robot (--scan TOPIC takes it)")
        return still
    return names


def _why_not_one_robot(seen: Survey, names: Sequence[str]) -> str:
    """Why these cannot be taken for different lasers of one robot; empty where they can."""
    frames = {name: seen.scans[name].frame for name in names}
    bases = {name: _base_above(seen, frame) for name, frame in frames.items()}
    told = set(bases.values())
    if "" not in told and len(told) > 1:
        return f"there are lasers of several robots ({', '.join(f'{name} on {base}' for name, base in bases.items())})"
    if len({_namespace(name) for name in names}) > 1 and "" in told:
        return "there are lasers in several namespaces, maybe of several robots"
    if "" in told:
        missing = next(name for name, base in bases.items() if not base)
        return f"there are several lasers, and the mounting of {missing} ({frames[missing]}) is unknown (no transform)"
    if len(set(frames.values())) < len(names):
        return f"several topics have scans of one laser ({', '.join(sorted(set(frames.values())))})"
    return ""


def _odometry_topic(
    source: BagSource, seen: Survey, options: LogOptions, scans: tuple[str, ...], remarks: list[str]
) -> str:
    if options.odometry_topic:
        name = _topic(options.odometry_topic)
        if name not in seen.odometry:
            there = _listed(seen.odometry) or "none"
            raise InputError(source.path, f"expected odometry (nav_msgs/Odometry) on {name}; topics of it: {there}")
        return name
    if options.odometry_frame:
        return ""
    names = [name for name in sorted(seen.odometry) if not _TRUTH.search(name)]
    left = [name for name in sorted(seen.odometry) if name not in names]
    if left:
        remarks.append(f"{_listed(left)} not used: by its name it is ground truth (--odom TOPIC takes it)")
    if len(names) > 1:
        spaces = {_namespace(name) for name in scans}
        names = [name for name in names if _namespace(name) in spaces] or names
    if len(names) > 1:
        names = [name for name in names if _agrees(seen, name)] or names
    if len(names) > 1:
        raise InputError(source.path, f"there are several odometries: choose with --odom TOPIC among {_listed(names)}")
    return names[0] if names else ""


def _agrees(seen: Survey, name: str) -> bool:
    """Whether the transforms agree with the poses of this topic."""
    topic = seen.odometry[name]
    link = seen.links.get((topic.frame, topic.child_frame))
    if link is None:
        children = [ends for ends in seen.links if ends[0] == topic.frame]
        link = seen.links[children[0]] if len(children) == 1 and not topic.child_frame else None
    if link is None or not link.samples or not topic.samples:
        return False
    stamps = np.array([stamp_ns for stamp_ns, _ in sorted(link.samples)], dtype=np.float64)
    places = np.array([pose[:2] for _, pose in sorted(link.samples)])
    inside = [(stamp, pose) for stamp, pose in topic.samples if stamps[0] <= stamp <= stamps[-1]]
    if not inside:
        return False
    at = [float(stamp) for stamp, _ in inside]
    told = np.column_stack([np.interp(at, stamps, places[:, axis]) for axis in (0, 1)])
    return bool(np.median(np.hypot(*(told - [pose[:2] for _, pose in inside]).T)) < _AGREES_M)


def _odometry_frame(seen: Survey, above: list[list[str]]) -> str:
    """Parent frame of the odometry in the transforms: above the lasers, or else the only one there is."""
    for frames in above:
        for frame in frames[1:]:
            if _ODOMETRY_FRAME.search(_last(frame)):
                return frame
    found = {parent for parent, _ in seen.links if _ODOMETRY_FRAME.search(_last(parent))}
    return found.pop() if len(found) == 1 else ""


def _below(seen: Survey, odometry_frame: str, above: list[list[str]]) -> str:
    """The base: what the odometry frame is the parent of, between it and a laser if there is one."""
    if not odometry_frame:
        return ""
    for frames in above:
        if odometry_frame in frames[1:]:
            return frames[frames.index(odometry_frame) - 1]
    children = [child for parent, child in seen.links if parent == odometry_frame]
    named = [child for base in _BASES for child in children if _last(child) == base]
    return (named or children or [""])[0]


def _base_above(seen: Survey, frame: str) -> str:
    """The base that a laser is mounted on, by the transforms; empty if unknown."""
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


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names)


def _topic(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _bare(frame: str) -> str:
    return frame.lstrip("/")


def _last(name: str) -> str:
    return name.rpartition("/")[2]


def _namespace(topic: str) -> str:
    """First part of a topic's name, if it has several."""
    first, _, rest = topic.strip("/").partition("/")
    return first if rest else ""
