"""Where a robot's base is by its odometry, how uncertain, and where its lasers are on it, while a bag is read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry import rigid
from gridslam.geometry.angles import wrap
from gridslam.geometry.rigid import Rigid
from gridslam.io.bags.ros_messages import OdometryMessage, StampedTransform
from gridslam.io.bags.survey import Choice, Step, Survey, differs
from gridslam.io.log_statistics import Mounting
from gridslam.io.measurement import FARTHEST_LASER_M
from gridslam.transforms import Coverage, MissingTransform, TransformBuffer
from gridslam.types import Odometry

_KEEP_S = 5.0  # of odometry: no wider gap is interpolated, and a scan may be this much behind the latest reading
_ODOMETRY = "(odometry)"  # parent frame for an odometry topic, distinct from the same link on /tf
_IDENTITY: Rigid = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@final
class MountedLaser:
    """A laser on the robot. Its mounting is known from the survey on, and followed where it moves.

    Parameters
    ----------
    way : sequence of Step or None
        Links from the base to the laser; None without transforms.
    poses : dict
        Pose of each link, kept up to date by `Rig`.
    source : str
        Where the mounting is known from.

    Attributes
    ----------
    base_from_laser : (4, 4) float64
        The mounting now: another object after it has moved by more than 5 mm or 0.01 rad.
    """

    def __init__(self, way: Sequence[Step] | None, poses: dict[tuple[str, str], Rigid], source: str) -> None:
        self.way = () if way is None else tuple(way)
        self.is_known = way is not None
        self._source = source
        self._poses = poses
        self._first = self._last = self._composed()
        self.base_from_laser = rigid.to_matrix(self._last)

    def update(self) -> None:
        """Take in that a link has another pose; raises ArgumentError where no laser can be so far from its robot."""
        now = self._composed()
        if differs(self._last, now):
            self._last = now
            self.base_from_laser = rigid.to_matrix(now)

    @property
    def has_moved(self) -> bool:
        """Whether the mounting is another than at first."""
        return self._last is not self._first and differs(self._first, self._last)

    @property
    def mounting(self) -> Mounting:
        """For the statistics; of a laser that looks straight up or down the yaw is 0."""
        try:
            x, y, yaw = rigid.planar(self._last)
        except ArgumentError:
            x, y = self._last[:2]
            yaw = 0.0
        return Mounting(np.array((x, y, wrap(yaw))), self._source)

    def _composed(self) -> Rigid:
        motion = _IDENTITY
        for link, down in self.way:
            pose = self._poses[link]
            motion = rigid.compose(motion, pose if down else rigid.inverse(pose))
        if not math.hypot(*motion[:3]) < FARTHEST_LASER_M:
            raise ArgumentError("pose", f"a laser within {FARTHEST_LASER_M:g} m of its base", list(motion[:3]))
        return motion


@final
class Rig:
    """Processes odometry and transforms in the order of a log; gives the odometry at a stamp and the mountings.

    Links that were static in the survey hold for the whole log until their pose changes: a static transform is often
    published late, and in old logs repeatedly with later stamps.

    Attributes
    ----------
    latest_ns : int
        Stamp of the odometry that came last; beyond all stamps where there is none to come.
    topics : frozenset of str
        Topics of the transforms that matter.
    """

    def __init__(self, choice: Choice, seen: Survey) -> None:
        self._seen = seen
        self._base = choice.base_frame
        self._frame = _ODOMETRY if choice.odometry else choice.odometry_frame
        self._child = choice.odometry_child
        self.latest_ns = -1 if self._frame else 1 << 63  # nothing to wait for
        self._buffer = TransformBuffer(_KEEP_S)
        self._lasers: dict[str, MountedLaser] = {}
        self._followed: dict[tuple[str, str], list[MountedLaser]] = {}
        start = choice.odometry_child if choice.odometry else choice.odometry_frame
        way = seen.way(start, self._base) if self._frame else None
        self._odometry_links = {step.link for step in way or ()}
        self._upward = {step.link for step in way or () if choice.odometry and not step.down}
        self._moving = {step.link for step in (way or ())[:1] if not choice.odometry}
        mounts = [seen.way(self._base, seen.scans[name].frame) or [] for name in choice.scans]
        links = self._odometry_links.union(step.link for way in mounts for step in way)
        self.topics = frozenset(seen.links[link].topic for link in links)
        self._reported = {link: seen.links[link].pose for link in links}
        self._poses = dict(self._reported)
        for link in self._odometry_links - self._moving:
            self._add(link, 0, self._poses[link], static=True)

    @property
    def has_odometry(self) -> bool:
        """Whether there is any to wait for."""
        return bool(self._frame)

    def add_odometry(self, message: OdometryMessage) -> None:
        """Take in a message of the odometry's topic; raises ArgumentError where it is no pose."""
        pose = message.pose
        self._buffer.add_quaternion(_ODOMETRY, self._child, message.stamp_ns, pose[:3], pose[3:])
        self.latest_ns = message.stamp_ns

    def add_transform(self, transform: StampedTransform) -> bool:
        """Add a transform; return whether it may be odometry; raises ArgumentError if it is not a pose."""
        link = transform.parent, transform.child
        if link in self._moving:
            pose = rigid.from_quaternion(transform.pose[:3], transform.pose[3:])
            self._add(link, transform.stamp_ns, pose, static=False)
            self.latest_ns = transform.stamp_ns
            if link in self._followed:
                self._follow(link, pose)
            return True
        before = self._reported.get(link)
        if before is None or transform.pose == before:
            return False
        self._reported[link] = transform.pose
        now = rigid.from_quaternion(transform.pose[:3], transform.pose[3:])
        if link in self._odometry_links and differs(self._poses[link], now):
            self._moving.add(link)
            self._add(link, transform.stamp_ns, now, static=False)
        self._follow(link, now)
        return False

    def odometry(self, stamp_ns: int) -> tuple[Coverage, Odometry | None]:
        """Pose of the base in the odometry frame; or why it is unknown."""
        try:
            pose = self._buffer.planar(self._frame, self._base, stamp_ns)
        except MissingTransform as missing:
            return missing.coverage, None
        return Coverage.KNOWN, Odometry.at(stamp_ns, pose)

    def laser(self, frame: str) -> MountedLaser:
        """Return the laser of this frame."""
        if frame not in self._lasers:
            self._lasers[frame] = self._mounted(frame)
        return self._lasers[frame]

    def _mounted(self, frame: str) -> MountedLaser:
        way = self._seen.way(self._base, frame)
        if way is None:
            missing = f"no transform names {frame}" if frame else "the scans name no frame (header.frame_id is empty)"
            return MountedLaser(None, {}, f"{missing}: taken to be at the robot's base")
        for link, _ in way:  # a topic may have scans of several frames
            self._poses.setdefault(link, self._reported.setdefault(link, self._seen.links[link].pose))
        topics = sorted({self._seen.links[link].topic for link, _ in way})
        source = f"{', '.join(topics)}: {self._base} to {frame}" if way else f"{frame} is the base"
        try:
            found = MountedLaser(way, self._poses, source)
        except ArgumentError:
            return MountedLaser(
                None, {}, f"{source} puts it out of reach ({FARTHEST_LASER_M:g} m): taken to be at the robot's base"
            )
        for link, _ in way:
            self._followed.setdefault(link, []).append(found)
        return found

    def _follow(self, link: tuple[str, str], pose: Rigid) -> None:
        before, self._poses[link] = self._poses[link], pose
        try:
            for laser in self._followed.get(link, ()):
                laser.update()
        except ArgumentError:
            self._poses[link] = before
            raise

    def _add(self, link: tuple[str, str], stamp_ns: int, pose: Rigid, *, static: bool) -> None:
        """Give a link to the buffer, which leads down from the odometry: a frame has one parent there."""
        if link in self._upward:
            link, pose = (link[1], link[0]), rigid.inverse(pose)
        self._buffer.add_quaternion(*link, stamp_ns, pose[:3], pose[3:], static)
