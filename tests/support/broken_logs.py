"""Logs of every format, damaged at random in every way that files and recorders damage them."""

from __future__ import annotations

import bz2
import gzip
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from gridslam.io.carmen.writer import write_carmen
from gridslam.io.csv import write_csv_log
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support import ros_bags
from support.ros_bags import Said

_SCANS = 12
_BEAMS = 40
_WORDS = (
    b"nan",
    b"inf",
    b"-inf",
    b"1e308",
    b"-1e308",
    b"1e999",
    b"1e15",
    b"-1e9",
    b"3000000",
    b"0",
    b"-1",
    b"",
    b"9" * 30,
    b"x",
    b"\x00",
    b"\xff\xfe",
    b"1_0",
    b"0x10",
    b"\n",
    b"\r",
    b",",
    b'"',
    b"#",
    b"FLASER",
    b"ROBOTLASER1",
    b"ODOM",
    b"PARAM robot_frontlaser_offset",
)
_FLOATS = (math.nan, math.inf, -math.inf, 1e308, -1e30, 1e15, 1e-300, 0.0, -1.0, 3e6)
_NUMBERS = (0, 1, -1, 255, 1 << 31, (1 << 31) - 1, 1 << 32, (1 << 63) - 1, 1 << 20)

_BAGS = (
    ("ros1", ""),
    ("ros1", "bz2"),
    ("ros1", "lz4"),
    ("db3", ""),
    ("db3", "message"),
    ("mcap", ""),
    ("mcap", "file"),
    ("mcap", "storage"),
)

Damage = Callable[[bytes, np.random.Generator], bytes]


class Whole(NamedTuple):
    """A whole log: the name of its file, and what makes damaged bytes of it and tells which damage it is."""

    name: str
    damaged: Callable[[np.random.Generator], tuple[bytes, str]]


def whole_logs(folder: Path) -> list[Whole]:
    """One log of each format and compression, of the same short drive."""
    measurements = drive_about(_SCANS)
    write_csv_log(folder / "log.csv", measurements)
    write_carmen(folder / "log.clf", measurements)
    carmen, csv = (folder / "log.clf").read_bytes(), (folder / "log.csv").read_bytes()
    found = [
        _text("log.clf", carmen),
        _text("log.clf", carmen.replace(b"FLASER", b"RLASER", 3)),
        _text("log.clf", _robotlaser(measurements)),
        _text("log.csv", csv),
        _text("log.csv", rostopic_rows(measurements)),
        _text("echo.csv", echo_rows(measurements)),
        _text("log.txt", point_rows(measurements)),
        _text("log.clf.gz", carmen, gzip.compress),
        _text("log.clf.bz2", carmen, bz2.compress),
        _packed("log.clf.gz", gzip.compress(carmen, mtime=0)),
        _packed("log.clf.bz2", bz2.compress(carmen)),
        _packed("log.csv.gz", gzip.compress(csv, mtime=0)),
    ]
    for kind, compression in _BAGS:
        path = _bag(folder, kind, _messages(measurements), compression)
        found.append(_packed(path.name, path.read_bytes()))
    return found + [_of_messages(folder, kind, measurements) for kind in (*ros_bags.KINDS, "ros1")]


def rostopic_rows(measurements: Sequence[Measurement]) -> bytes:
    """The scans as `rostopic echo -p` prints them."""
    fields = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time", "range_min", "range_max")
    names = [f"field.{name}" for name in ("header.seq", "header.stamp", "header.frame_id", *fields)]
    lines = [",".join(["%time", *names, *(f"field.ranges{k}" for k in range(len(measurements[0].scan)))])]
    for number, (_, scan) in enumerate(measurements):
        bearings = scan.geometry.bearings
        angles = bearings[0], bearings[-1], bearings[1] - bearings[0]
        values = (*angles, 0.0, 0.1, scan.range_min_m, scan.range_max_m, *scan.ranges)
        lines.append(f"{scan.stamp_ns},{number},{scan.stamp_ns},laser,{','.join(f'{value:.9g}' for value in values)}")
    return ("\n".join(lines) + "\n").encode()


def echo_rows(measurements: Sequence[Measurement], *, with_intensities: bool = False) -> bytes:
    """The scans as `ros2 topic echo --csv` prints them: without names."""
    lines = []
    for _, scan in measurements:
        bearings = scan.geometry.bearings
        angles = bearings[0], bearings[-1], bearings[1] - bearings[0]
        bright = np.ones(len(scan)) if with_intensities else ()
        values = (*angles, 0.0, 0.1, scan.range_min_m, scan.range_max_m, *scan.ranges, *bright)
        seconds, nanoseconds = divmod(scan.stamp_ns, 10**9)
        end = "" if with_intensities else ","  # an empty array is an empty cell
        lines.append(f"{seconds},{nanoseconds},laser,{','.join(f'{value:.9g}' for value in values)}{end}")
    return ("\n".join(lines) + "\n").encode()


def point_rows(measurements: Sequence[Measurement]) -> bytes:
    """The scans as rows of a time, an angle in degrees and a distance in mm."""
    lines = ["t,angle_deg,dist_mm"]
    for _, scan in measurements:
        for bearing, distance in zip(np.degrees(scan.geometry.bearings), scan.ranges, strict=True):
            lines.append(f"{scan.stamp_ns / 1e9:.3f},{bearing:.6f},{1000 * distance:.3f}")
    return ("\n".join(lines) + "\n").encode()


def _text(name: str, content: bytes, wrap: Callable[[bytes], bytes] = bytes) -> Whole:
    return Whole(name, lambda rng: damage(content, OF_TEXT, rng, wrap))


def _packed(name: str, content: bytes) -> Whole:
    return Whole(name, lambda rng: damage(content, OF_BYTES, rng))


def _of_messages(folder: Path, kind: str, measurements: Sequence[Measurement]) -> Whole:
    """A bag that is whole, with messages that are not."""

    def damaged(rng: np.random.Generator) -> tuple[bytes, str]:
        share, done = float(rng.choice([0.03, 0.1, 0.5])), []

        def altered(message: bytes) -> bytes:
            if rng.random() >= share:
                return message
            content, what = damage(message, _OF_MESSAGES, rng)
            done.append(what)
            return content

        return _bag(folder, kind, _messages(measurements), "", altered).read_bytes(), f"messages: {', '.join(done)}"

    return Whole(_bag(folder, kind, _messages(measurements), "").name, damaged)


def _bag(
    folder: Path, kind: str, messages: Iterable[Said], compression: str, altered: Callable[[bytes], bytes] = bytes
) -> Path:
    """The file of a bag."""
    with TemporaryDirectory(dir=folder) as aside:
        written = ros_bags.write(Path(aside), kind, messages, compression, f"{kind}{compression}", altered)
        file = written if written.is_file() else next(file for file in written.iterdir() if file.suffix != ".yaml")
        return file.replace(folder / file.name)


def damage(
    content: bytes, damages: Sequence[Damage], rng: np.random.Generator, wrap: Callable[[bytes], bytes] = bytes
) -> tuple[bytes, str]:
    """Damage bytes in one to three ways out of `damages`, and `wrap` them; what was done, too."""
    done = []
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        kind = damages[rng.integers(len(damages))]
        content = kind(content, rng)
        done.append(kind.__name__.strip("_"))
    return wrap(content), " + ".join(done)


def drive_about(scans: int) -> Sequence[Measurement]:
    """Measurements of a short drive, every third of the laser's."""
    world, rng = make_world("demo", np.random.default_rng(0)), np.random.default_rng(1)
    lidar = LidarConfig(beams=_BEAMS, field_of_view_rad=math.pi, range_max_m=20.0)
    return simulate(world, RobotConfig(), OdometryNoise(), lidar, rng).measurements[: 3 * scans : 3]


def _robotlaser(measurements: Sequence[Measurement]) -> bytes:
    lines = []
    for odometry, scan in measurements:
        pose = " ".join(f"{value:.4f}" for value in odometry.pose)
        ranges = " ".join(f"{value:.3f}" for value in np.minimum(scan.ranges, 20))
        beams, stamp = len(scan.ranges), f"{scan.stamp_ns / 1e9:.6f}"
        laser = f"0 -1.570796 3.141593 {math.pi / beams:.6f} 20 0.01 0"
        lines.append(f"ROBOTLASER1 {laser} {beams} {ranges} 0 {pose} {pose} 0 0 0 0 0 {stamp} host {stamp}\n")
    return "".join(lines).encode()


def _messages(measurements: Sequence[Measurement]) -> Iterator[Said]:
    """The drive as messages: odometry in its topic, the laser's place in /tf_static."""
    yield ros_bags.transform(0.0, "base_link", "laser", (0.1, 0.0, 0.3))
    for odometry, scan in measurements:
        at_s, bearings = scan.stamp_ns / 1e9, scan.geometry.bearings
        angles = float(bearings[0]), float(bearings[1] - bearings[0])
        yield ros_bags.odometry("/odom", at_s, odometry.pose.tolist())
        ranges, limits = scan.ranges.tolist(), (0.05, 20.0)
        yield ros_bags.scan("/scan", at_s, ranges, angles=angles, limits=limits, time_increment=1e-4)


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: int(len(content) * rng.random())]


def _lose(content: bytes, rng: np.random.Generator) -> bytes:
    """Lose a piece in the middle."""
    begin = int(rng.integers(len(content) + 1))
    return content[:begin] + content[begin + int(rng.integers(1, 200)) :]


def _flip(content: bytes, rng: np.random.Generator) -> bytes:
    """Change some bytes."""
    data = bytearray(content)
    for place in rng.integers(len(data), size=rng.integers(1, 9)) if data else ():
        data[place] ^= 1 << int(rng.integers(8))
    return bytes(data)


def _splice(content: bytes, rng: np.random.Generator) -> bytes:
    """Put a piece where it does not belong, and over what is there."""
    begin, end = sorted(rng.integers(len(content) + 1, size=2).tolist())
    place = int(rng.integers(len(content) + 1))
    piece = content[begin : min(end, begin + 300)]
    return content[:place] + piece + content[place + int(rng.integers(2)) * len(piece) :]


def _blank(content: bytes, rng: np.random.Generator) -> bytes:
    """Fill a block with zeros, as a disk does that never wrote it."""
    begin = int(rng.integers(len(content) + 1))
    size = min(int(rng.choice([1, 8, 64, 512, 4096])), len(content) - begin)
    return content[:begin] + bytes(size) + content[begin + size :]


def _number(content: bytes, rng: np.random.Generator) -> bytes:
    """Write a number that is none, or too large, over some bytes."""
    kinds = [struct.pack("<f", min(max(value, -3e38), 3e38)) for value in _FLOATS]
    kinds += [struct.pack("<d", value) for value in _FLOATS]
    kinds += [struct.pack("<q", value)[:4] for value in _NUMBERS] + [struct.pack("<q", value) for value in _NUMBERS]
    data = bytearray(content)
    for _ in range(rng.integers(1, 6)):
        place, piece = int(rng.integers(len(data) + 1)), kinds[rng.integers(len(kinds))]
        data[place : place + len(piece)] = piece
    return bytes(data)


def _word(content: bytes, rng: np.random.Generator) -> bytes:
    """Write another word in the place of one or more."""
    lines = content.split(b"\n")
    for _ in range(rng.integers(1, 4)):
        line = int(rng.integers(len(lines)))
        blank = b"," if b"," in lines[line] and rng.integers(2) else b" "
        words = lines[line].split(blank)
        place = int(rng.integers(len(words)) if rng.integers(2) else rng.integers(-min(len(words), 12), 0))
        words[place] = _WORDS[rng.integers(len(_WORDS))]
        lines[line] = blank.join(words)
    return b"\n".join(lines)


def _swap_words(content: bytes, rng: np.random.Generator) -> bytes:
    """Swap two fields of a line."""
    lines = content.split(b"\n")
    line = int(rng.integers(len(lines)))
    blank = b"," if b"," in lines[line] else b" "
    words = lines[line].split(blank)
    a, b = rng.integers(len(words), size=2)
    words[a], words[b] = words[b], words[a]
    lines[line] = blank.join(words)
    return b"\n".join(lines)


def _splice_lines(content: bytes, rng: np.random.Generator) -> bytes:
    """Join the begin of one line to the end of another, as where two programs write at once."""
    lines = content.split(b"\n")
    a, b = rng.integers(len(lines), size=2)
    lines[a] = lines[a][: rng.integers(len(lines[a]) + 1)] + lines[b][rng.integers(len(lines[b]) + 1) :]
    return b"\n".join(lines)


def _swap_lines(content: bytes, rng: np.random.Generator) -> bytes:
    lines = content.split(b"\n")
    a, b = rng.integers(len(lines), size=2)
    lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines)


OF_BYTES: tuple[Damage, ...] = (_cut, _lose, _flip, _splice, _blank, _number)
OF_TEXT: tuple[Damage, ...] = (
    _cut,
    _lose,
    _flip,
    _splice,
    _word,
    _word,
    _word,
    _swap_words,
    _splice_lines,
    _swap_lines,
)
_OF_MESSAGES: tuple[Damage, ...] = (_number, _number, _number, _flip, _cut, _blank, _lose)
