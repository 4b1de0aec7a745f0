"""Small files that unpack to much, or never end."""

from __future__ import annotations

import bz2
import gzip
import importlib
import math
import os
import shutil
import sqlite3
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
from PIL import Image

ZSTD = importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
MAP_YAML = (
    "image: map.pgm\nresolution: 0.05\norigin: [-1.0, -2.0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
)


def text(to: Path, size: int, files: Path) -> None:
    """A log with blank lines, or the same comment, without end."""
    filling = (b"\n", b"# nothing\n", b"ODOM 0 0 0 0 0 0 1 a 1\n")[size % 3]
    compressor = bz2.BZ2Compressor(1) if size % 2 else None
    with open(to / "log.clf", "wb") as raw:
        block = filling * ((1 << 20) // len(filling))
        if compressor:
            raw.write(compressor.compress((files / "log.clf").read_bytes()))
            for _ in range(min(size >> 20, 100)):
                raw.write(compressor.compress(block))
            raw.write(compressor.flush())
            return
        with gzip.GzipFile(fileobj=raw, mode="wb", compresslevel=1) as file:
            file.write((files / "log.clf").read_bytes())
            for _ in range(min(size >> 20, 400)):
                file.write(block)


def sparse(to: Path, size: int, files: Path) -> None:
    name = ("log.clf", "map.yaml", "trajectory.tum", "graph.g2o", "run.json")[(size >> 20) % 5]
    (to / name).write_bytes(
        (files / "log.clf").read_bytes()[:300] if name == "log.clf" else b"{" if name == "run.json" else b"# a\n"
    )
    os.truncate(to / name, size)


def storage(to: Path, size: int, files: Path) -> None:
    compressor = ZSTD.ZstdCompressor()
    with open(to / "log.db3.zst", "wb") as file:
        file.write(compressor.compress((files / "log.db3").read_bytes()))
        block = bytes(1 << 20)
        for _ in range(size >> 20):
            file.write(compressor.compress(block))
        file.write(compressor.flush())


def message(to: Path, size: int, files: Path) -> None:
    shutil.copy(files / "log.db3", to / "log.db3")
    with sqlite3.connect(to / "log.db3") as connection:
        connection.execute("UPDATE messages SET data = ?", (ZSTD.compress(bytes(min(size, 200 << 20))),))
    connection.close()


def view(to: Path, size: int, files: Path) -> None:
    shutil.copy(files / "log.db3", to / "log.db3")
    endless = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
    with sqlite3.connect(to / "log.db3") as connection:
        table = ("messages", "topics")[(size >> 20) % 2]
        connection.execute(f"DROP TABLE {table}")
        if table == "messages":
            connection.execute(
                f"CREATE VIEW messages AS {endless} SELECT x AS id, 1 AS topic_id, x AS timestamp, "
                "zeroblob(10) AS data FROM c"
            )
        else:
            connection.execute(
                f"CREATE VIEW topics AS {endless} SELECT x AS id, 'a' AS name, 'sensor_msgs/msg/LaserScan' AS type, "
                "'cdr' AS serialization_format, '' AS offered_qos_profiles, '' AS type_description_hash FROM c"
            )
    connection.close()


def chunk(to: Path, size: int, files: Path) -> None:
    packed = bz2.compress(bytes(min(size, 200 << 20)))
    (to / "log.bag").write_bytes(_bag(packed, size))


def archive(to: Path, size: int, files: Path) -> None:
    with zipfile.ZipFile(to / "state.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name, array in {"schema": np.array("gridslam.saved_run/4")}.items():
            with file.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, array)
        with file.open("zeros.npy", "w", force_zip64=True) as member:
            np.lib.format.write_array_header_1_0(
                member, {"descr": "<f8", "fortran_order": False, "shape": (size >> 3,)}
            )
            for _ in range(size >> 20):
                member.write(bytes(1 << 20))


def claims(to: Path, size: int, files: Path) -> None:
    """An array whose header claims far more than is there."""
    with zipfile.ZipFile(to / "state.npz", "w") as file, file.open("zeros.npy", "w") as member:
        shape = (size << 4,)
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": shape})


def image(to: Path, size: int, files: Path) -> None:
    side = int(math.sqrt(min(size, 170_000_000)))
    Image.new("L", (side, side), 254).save(to / "map.png", compress_level=1)
    (to / "map.yaml").write_text(MAP_YAML.replace("map.pgm", "map.png"))


def aliases(to: Path, size: int, files: Path) -> None:
    """YAML whose every line doubles the one before."""
    lines = ["a0: &a0 [x, x]"] + [f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, 40)]
    lists = [f"- &b{k} [*b{k - 1}, *b{k - 1}]" if k else "- &b0 [x, x]" for k in range(40)]
    tables = ["c0: &c0 {x: 1}"] + [f"c{k}: &c{k} {{p: *c{k - 1}, q: *c{k - 1}}}" for k in range(1, 40)]
    (to / "parameters.yaml").write_text("\n".join((lines, lists, tables)[(size >> 20) % 3]) + "\n")


def nested(to: Path, size: int, files: Path) -> None:
    depth = min(size >> 10, 100_000)
    name = ("parameters.yaml", "run.json", "run.toml")[(size >> 20) % 3]
    (to / name).write_text({"run.toml": "a = "}.get(name, "") + "[" * depth + "]" * depth)


def _bag(packed: bytes, size: int) -> bytes:
    """A ROS 1 bag of a single chunk, which claims `size` bytes."""

    def record(content: bytes, **fields: bytes) -> bytes:
        pairs = [name.encode() + b"=" + value for name, value in fields.items()]
        header = b"".join(struct.pack("<I", len(pair)) + pair for pair in pairs)
        return struct.pack("<I", len(header)) + header + struct.pack("<I", len(content)) + content

    claimed = struct.pack("<I", min(size, (1 << 32) - 1))
    start = record(b"", op=b"\x03", index_pos=bytes(8), conn_count=bytes(4), chunk_count=bytes(4))
    return b"#ROSBAG V2.0\n" + start + record(packed, op=b"\x05", compression=b"bz2", size=claimed)


BOMBS = text, sparse, storage, message, view, chunk, archive, claims, image, aliases, nested
"""Each writes a file to a folder; gets the folder, a size in bytes, and the folder of a healthy log.clf and log.db3."""
