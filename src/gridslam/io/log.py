"""Logs of any format: which one a file has, by its content, and the reader of the part that is asked for."""

from __future__ import annotations

import re
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TypeAlias

from gridslam.arguments import describe
from gridslam.checked import checked
from gridslam.errors import ArgumentError, InputError
from gridslam.io.carmen.lines import SCAN_TAGS
from gridslam.io.carmen.reader import CarmenLog
from gridslam.io.csv import CsvLog
from gridslam.io.foreign_scans import is_foreign_table
from gridslam.io.selection import Log, LogOptions, select
from gridslam.io.text import open_for_reading, read_head
from gridslam.io.trajectories import CSV_HEADER

__all__ = ["Log", "LogFormat", "LogOptions", "LogSource", "detect_log_format", "open_if_path", "open_log"]

LogSource: TypeAlias = str | Path | Log
"""Arguments that functions accept as a log: a path, or an open log as of `open_log`."""

_ALL = LogOptions()
_LOG_FORMATS = "a CARMEN log or a CSV of scans (plain, .gz or .bz2), a ROS 1 bag, a ROS 2 bag (folder, .db3 or .mcap)"
_HEAD_BYTES = 1 << 16
_CARMEN_TAGS = frozenset(tag.encode() for tag in (*SCAN_TAGS, "ODOM", "PARAM"))
_BAG_MAGIC = b"#ROSBAG V2", b"\x89MCAP", b"SQLite format 3\x00", b"\x28\xb5\x2f\xfd"  # the last one: zstd
_OTHER_MAGIC = {
    b"PK\x03\x04": "a zip archive (unpack it first)",
    b"\xfd7zXZ": "an xz archive (unpack it first)",
    b"\x89PNG": "a picture",
    b"\xff\xd8\xff": "a picture",
    b"P5": "a picture",
    b"%PDF": "a PDF document",
    b"\x89HDF": "an HDF5 file",
    b"PAR1": "a Parquet file",
    b"# .PCD": "a point cloud",
    **dict.fromkeys(
        (b"#ROSBAG V1", b"#ROSRECORD V", b"#ROSLOG V"),
        "a ROS 1 bag of the old format V1 (rosbag filter OLD.bag NEW.bag True writes it as V2.0)",
    ),
    b"header:": "messages as text (the table of rostopic echo -p -b BAG /scan is read, and so is the bag itself)",
    b"version https://git-lfs": "a pointer of Git LFS (fetch the file itself: git lfs pull)",
}
_NUMBER = re.compile(r"[-+]?(?:[\d.]+(?:e[-+]?\d+)?|inf|nan)", re.IGNORECASE)
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


class LogFormat(Enum):
    """Formats of logs that hold scans."""

    CARMEN = "CARMEN"
    BAG = "bag"
    CSV = "CSV"


@checked
def open_log(path: str | Path, options: LogOptions = _ALL) -> Log:
    """Open a log of any format that can be read, detected from its content: CARMEN, ROS 1 and ROS 2 bags, CSV.

    Parameters
    ----------
    path : str or Path
        The log: a file, or the folder of a ROS 2 bag.
    options : LogOptions
        What to read of it.

    Raises
    ------
    InputError
        There is no such file, or it is no log: names what it looks like; or an option does not fit its format.
    """
    form = detect_log_format(path)
    if form is LogFormat.BAG:
        from gridslam.io.bags.bag import BagLog  # only bags pay for the import of rosbags

        part = replace(options, scan_topics=())  # the reader takes care of the topics
        return select(BagLog(path, replace(options, start_s=0.0, duration_s=None, every=1)), part)
    if options.odometry_topic or options.odometry_frame or options.base_frame:
        raise InputError(path, f"topics and frames are chosen in bags alone, and this is a {form.value} log")
    if form is LogFormat.CSV:
        return select(CsvLog(path, keep_truncated=options.keep_truncated), options)
    return select(CarmenLog(path, keep_truncated=options.keep_truncated), options)


def open_if_path(log: LogSource, options: LogOptions | None = None) -> Log:
    """Open the log at a path, and give one that is open as it is.

    Raises
    ------
    ArgumentError
        It is neither, or there are `options` for a log that is open already.
    InputError
        As `open_log`.
    """
    if isinstance(log, str | Path):
        return open_log(log, options or LogOptions())
    if not isinstance(log, Log):
        raise ArgumentError("log", "str, Path or a log as open_log gives it", describe(log))
    if options is not None:
        raise ArgumentError("options", "none for a log that is open already", options)
    return log


def detect_log_format(path: str | Path) -> LogFormat:
    """Detect the format of a log from its content, not from its name.

    Raises
    ------
    InputError
        There is no such file, it is empty, or it cannot be read: names what it looks like.
    """
    where = Path(path)
    if where.is_dir():
        if any(where.glob("*.db3*")) or any(where.glob("*.mcap*")) or (where / "metadata.yaml").exists():
            return LogFormat.BAG
        raise InputError(path, f"expected {_LOG_FORMATS}, got a folder without metadata.yaml, .db3 or .mcap")
    head = read_head(path, _HEAD_BYTES)
    if head.startswith(_BAG_MAGIC):
        with open_for_reading(path) as file:
            if file.read(len(head)).startswith(_BAG_MAGIC):
                return LogFormat.BAG
        raise InputError(path, "expected a bag that is not compressed as a whole, got a compressed one (unpack it)")
    if not head or _has_carmen_tag(head):  # empty: cut off or damaged in the first block; reported by the reader
        return LogFormat.CARMEN
    first = _first_line(head)
    if _is_scan_csv(first) or is_foreign_table(head.decode("utf-8", "replace")):
        return LogFormat.CSV
    raise InputError(path, f"expected {_LOG_FORMATS}, got {_looks_like(head, first)}")


def _has_carmen_tag(head: bytes) -> bool:
    return any(line.split(None, 1)[0] in _CARMEN_TAGS for line in head.split(b"\n") if line and not line.isspace())


def _first_line(head: bytes) -> str:
    """Return the first line that is not blank."""
    lines = (line.strip() for line in head.decode("utf-8-sig", "replace").split("\n"))
    return next((line for line in lines if line and not line.startswith("#")), "")


def _is_scan_csv(line: str) -> bool:
    names = {name.strip().strip('"') for name in re.split("[,;\t]", line)}
    return bool(names & {"stamp_s", "ranges_m"}) and line != CSV_HEADER


def _looks_like(head: bytes, line: str) -> str:
    """Describe a file that is no log by its first bytes."""
    for magic, what in _OTHER_MAGIC.items():
        if head.startswith(magic):
            return what
    if head[257:262] == b"ustar":
        return "a tar archive (unpack it first)"
    if _CONTROL.search(head):
        return f"binary data that begins with {head[:8].hex(' ')}"
    if line == CSV_HEADER or _is_tum(line):
        return "poses without scans (a trajectory, or relations)"
    if all(map(_NUMBER.fullmatch, re.split(r"[ ,;\t]+", line.strip(" ,;\t").strip("()[]")))):
        return "numbers without a line of names (such as angle_deg,dist_mm)"
    if line.startswith(("VERTEX", "EDGE")):
        return "a pose graph (gridslam graph solves it)"
    if line.startswith(("<!", "<html", "<?xml")):
        return "a web page or XML"
    return f"text that begins with {line[:40]!r}" if line else "text with blank lines only"


def _is_tum(line: str) -> bool:
    words = line.split()
    try:
        return len(words) == 8 and all(abs(float(word)) < float("inf") for word in words)
    except ValueError:
        return False
