"""Which format a log has, by its content; and what a file that is none looks like."""

from __future__ import annotations

import re
from enum import Enum
from pathlib import Path

from gridslam.errors import InputError
from gridslam.io.carmen.lines import SCAN_TAGS
from gridslam.io.text import open_for_reading, read_head
from gridslam.io.trajectories import CSV_HEADER

__all__ = ["LOG_FORMATS", "LogFormat", "detect_log_format"]

LOG_FORMATS = "a CARMEN log or a CSV of scans (plain, .gz or .bz2), a ROS 1 bag, a ROS 2 bag (folder, .db3 or .mcap)"
"""What can be read, in words."""

_HEAD_BYTES = 1 << 16
_CARMEN_TAGS = frozenset(tag.encode() for tag in (*SCAN_TAGS, "ODOM", "PARAM"))
_BAG_MAGIC = b"#ROSBAG V", b"\x89MCAP", b"SQLite format 3\x00", b"\x28\xb5\x2f\xfd"  # the last one: zstd
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
    b"version https://git-lfs": "a pointer of Git LFS (fetch the file itself: git lfs pull)",
}
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


class LogFormat(Enum):
    """Formats of logs that hold scans."""

    CARMEN = "CARMEN"
    BAG = "bag"
    CSV = "CSV"


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
        raise InputError(path, f"expected {LOG_FORMATS}, got a folder without metadata.yaml, .db3 or .mcap")
    head = read_head(path, _HEAD_BYTES)
    if head.startswith(_BAG_MAGIC):
        with open_for_reading(path) as file:
            if file.read(len(head)).startswith(_BAG_MAGIC):
                return LogFormat.BAG
        raise InputError(path, "expected a bag that is not compressed as a whole, got a compressed one (unpack it)")
    if not head or _has_carmen_tag(head):  # empty: cut off or damaged in the first block; reported by the reader
        return LogFormat.CARMEN
    first = _first_line(head)
    if _is_scan_csv(first):
        return LogFormat.CSV
    raise InputError(path, f"expected {LOG_FORMATS}, got {_looks_like(head, first)}")


def _has_carmen_tag(head: bytes) -> bool:
    return any(line.split(None, 1)[0] in _CARMEN_TAGS for line in head.split(b"\n") if line and not line.isspace())


def _first_line(head: bytes) -> str:
    """The first line that is not blank."""
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
