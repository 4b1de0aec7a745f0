"""Streaming reader of ROS 1 and ROS 2 bags."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import final

from gridslam.errors import InputError
from gridslam.io.bags.choice import Choice, choose
from gridslam.io.bags.reading import BagReading
from gridslam.io.bags.ros1 import Ros1Bag
from gridslam.io.bags.ros2 import Ros2Bag
from gridslam.io.bags.source import BagSource
from gridslam.io.bags.survey import Survey, survey
from gridslam.io.log_statistics import LogStatistics
from gridslam.io.measurement import Measurement
from gridslam.io.selection import LogOptions
from gridslam.io.text import open_for_reading

__all__ = ["BagLog"]

_ALL = LogOptions()
_LATE_S = 1.0  # transforms on /tf are published at least this often


@final
class BagLog:
    """A bag (ROS 1, or ROS 2 as a folder, .db3 or .mcap); iterating yields a `Measurement` for each scan.

    Scans of one laser come in the order of their recording; those of several are merged by their stamps. Stamps are
    those of the messages' headers (of a topic that leaves them 0, the times of recording). A scan's odometry is
    interpolated at its own stamp: scans wait for the reading after it, up to 1 s of the log. Where none comes, or none
    was before, the measurement is without odometry, which `statistics.missing_transforms` counts with the reason.
    Each iteration rereads the bag and restarts `statistics`; memory does not grow with the length of the log.

    The choice of topics and frames, and when the user must choose, is described at `bag_choice.choose`.

    Parameters
    ----------
    path : str or Path
        File or folder.
    options : LogOptions
        Topics, frames, `no_odometry` and `keep_truncated`; the choice of scans by time is not made here.

    Attributes
    ----------
    choice : Choice
        What is read.
    statistics : LogStatistics
        What the latest iteration has met so far; topics and remarks from the beginning.

    Raises
    ------
    InputError
        At construction where there is no such bag, it is damaged or cut off, it has no scans, or it is not clear what
        to read of it; while iterating where it turns out to be damaged, or a message cannot be decoded.
    """

    def __init__(self, path: str | Path, options: LogOptions = _ALL) -> None:
        """Look into the bag."""
        self.path = Path(path)
        self._source = _open(self.path, options.keep_truncated)
        self._seen = survey(self._source)
        self.choice = choose(self._source, self._seen, options)
        self.statistics = self._new_statistics()

    def __iter__(self) -> Iterator[Measurement]:
        """Read the log from its start."""
        statistics = self.statistics = self._new_statistics()
        yield from BagReading(self._source, self._seen, self.choice, statistics).measurements()
        statistics.bytes_read = self._source.bytes_read
        statistics.truncated = self._source.is_truncated
        if not statistics.scan_count:
            raise InputError(self.path, f"there are no scans on {', '.join(self.choice.scans)}")

    def _new_statistics(self) -> LogStatistics:
        source, choice = self._source, self.choice
        statistics = LogStatistics(total_bytes=source.total_bytes, topics=dict(source.topics))
        statistics.truncated = source.is_truncated
        if choice.odometry_frame:
            statistics.odometry_source = choice.odometry or f"{choice.odometry_frame} to {choice.base_frame} on /tf"
        statistics.remarks.update(_remarks(self._seen, choice))
        return statistics


def _open(path: Path, keep_truncated: bool) -> BagSource:
    if path.is_dir():
        return Ros2Bag(path, keep_truncated=keep_truncated)
    with open_for_reading(path) as file:
        is_ros1 = file.read(8) == b"#ROSBAG "
    return (Ros1Bag if is_ros1 else Ros2Bag)(path, keep_truncated=keep_truncated)


def _remarks(seen: Survey, choice: Choice) -> Counter[str]:
    """What the user may want to know before the log is read."""
    found = Counter(choice.remarks)
    for what, count in seen.unusable.items():
        found[f"{what} is no pose (not finite, or no rotation): left out"] += count
    for name in choice.scans:
        scans = seen.scans[name]
        if not scans.stamped:
            found[f"the scans of {name} are not stamped: the times of recording are taken"] += 1
        for link, _ in seen.way(choice.base_frame, scans.frame) or ():
            told = seen.links[link]
            late_s = 0.0 if told.static else (told.stamp_ns - scans.first_stamp_ns) / 1e9
            if late_s > _LATE_S:
                late = f"is first published {late_s:.1f} s after the first scan: assumed to hold before"
                found[f"{link[0]} -> {link[1]} {late}"] += 1
    return found
