"""Writer of ROS bags: ROS 1, ROS 2 in sqlite3 and in mcap, without ROS."""

from __future__ import annotations

import os
import secrets
import shutil
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from gridslam.errors import ArgumentError, OutputError
from gridslam.io.bags.messages import BagMessage, BagMessages
from gridslam.io.measurement import Measurement

if TYPE_CHECKING:  # rosbags is imported where a bag is written, and nowhere else
    from rosbags.interfaces import Connection

__all__ = ["write_bag"]

_Bag: TypeAlias = tuple[Mapping[str, Any], Callable[[BagMessage, int], None]]
"""Classes of the messages, and what takes a message and the time of its recording in ns."""

_FILES = {".bag": "ros1", ".mcap": "mcap", ".db3": "sqlite3"}
_ROS2_VERSION: Final = 8  # of the metadata: the later 9 is not read by ROS 2 before Jazzy


def write_bag(path: str | Path, measurements: Iterable[Measurement]) -> None:
    """Write a log as a bag, to be read by `BagLog` and played to a robot's software.

    Scans stand in /scan; those of a sensor that is named like a topic in that one, of further sensors in
    /scan_<sensor>. INVALID beams are NaN, those without return infinite. Odometry stands in /odom, with its mean
    velocity since the reading before, and in /tf as odom -> base_link; the covariance of its increments has no place.
    The laser's mounting stands in /tf_static as base_link -> its frame. Stamps and poses come back exactly, ranges and
    bearings to single precision.

    Headers carry the stamps as they are. The times of recording, by which a bag is read, are the same where these
    ascend, and later by as many ns as it takes to keep the log's order where they do not.

    Parameters
    ----------
    path : str or Path
        A ROS 1 bag where it ends in .bag, a ROS 2 bag in one file where it ends in .mcap or .db3, and otherwise the
        folder of a ROS 2 bag (sqlite3). It appears under its name only once it is whole. A file is replaced.
    measurements : iterable of Measurement
        In the order in which they are to stand in the log; may be a generator.

    Raises
    ------
    ArgumentError
        For data that messages cannot represent: beams that are not evenly spread in angle or in time, a mounting that
        changes, hits outside the range limits, stamps before 0 or from 2^31 s on; and for a log without any scan.
    OutputError
        Where the bag cannot be written, or a folder is in its place.
    """
    target = Path(path)
    if target.is_dir() and (target.suffix in _FILES or any(target.iterdir())):
        raise OutputError(f"{path}: expected a name for a new bag, but there is a folder")
    kind = _FILES.get(target.suffix, "sqlite3")
    if kind == "sqlite3" and set("?#%") & set(str(target)):
        raise OutputError(f"{path}: a path with ?, # or % cannot hold a sqlite3 bag: write .mcap, or elsewhere")
    aside = target.with_name(f".{target.name}.{secrets.token_hex(4)}.partial")
    try:
        aside.mkdir()
        if kind == "ros1":
            written = aside / "bag"
            _write(_ros1(written), measurements, numbered=True)
        else:
            written = aside / target.stem if target.suffix in _FILES else aside / target.name
            _write(_ros2(written, kind), measurements, numbered=False)
            if target.suffix in _FILES:
                written /= written.name + target.suffix
        os.replace(written, target)
    except (OSError, sqlite3.Error) as error:
        raise OutputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}") from None
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _write(opened: AbstractContextManager[_Bag], measurements: Iterable[Measurement], *, numbered: bool) -> None:
    """Write all messages in the log's order, at times of recording that ascend strictly."""
    recorded_ns = 0  # ROS 1 has no message at time 0
    with opened as (types, write):
        messages = BagMessages(types, numbered=numbered)
        for measurement in measurements:
            for message in messages.of(measurement):
                recorded_ns = max(recorded_ns + 1, message.stamp_ns)
                write(message, recorded_ns)
        if not recorded_ns:
            raise ArgumentError("measurements", "at least one scan", "none")


@contextmanager
def _ros1(path: Path) -> Iterator[_Bag]:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", "tf2_msgs/msg/TFMessage"))
    connections: dict[str, Connection] = {}
    with Writer(path) as bag:

        def write(message: BagMessage, recorded_ns: int) -> None:
            topic, kind, _, content = message
            if topic not in connections:
                latching = 1 if topic == "/tf_static" else None
                connections[topic] = bag.add_connection(
                    topic, kind, typestore=store, callerid="/gridslam", latching=latching
                )
            bag.write(connections[topic], recorded_ns, store.serialize_ros1(content, kind))

        yield store.types, write


@contextmanager
def _ros2(path: Path, storage: str) -> Iterator[_Bag]:
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    always = QosTime(0, 0)
    latched = Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, always, always,
        QosLiveliness.AUTOMATIC, always, False,
    )  # fmt: skip
    connections: dict[str, Connection] = {}
    with Writer(path, version=_ROS2_VERSION, storage_plugin=StoragePlugin[storage.upper()]) as bag:

        def write(message: BagMessage, recorded_ns: int) -> None:
            topic, kind, _, content = message
            if topic not in connections:
                qos = [latched] if topic == "/tf_static" else []
                connections[topic] = bag.add_connection(topic, kind, typestore=store, offered_qos_profiles=qos)
            bag.write(connections[topic], recorded_ns, store.serialize_cdr(content, kind))

        yield store.types, write
