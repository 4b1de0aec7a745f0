"""Viewers of the live page without a browser: they put messages together as the page does."""

from __future__ import annotations

import json
import struct
import zlib
from typing import Any

import numpy as np

from gridslam.kernels import TILE
from gridslam.live.tiles import TileReplica, split_into_tiles
from gridslam.types import OccupancyGrid


class PageClient:
    """What a page has after some messages."""

    def __init__(self) -> None:
        self.run_info: dict[str, Any] = {}
        self.status: dict[str, Any] = {}
        self.reported: list[dict[str, Any]] = []
        self.tiles: dict[tuple[int, int], np.ndarray] = {}
        self.path, self.series = np.zeros((0, 2), np.float32), np.zeros((0, 5), np.float32)
        self.arrays: dict[str, np.ndarray] = {}
        self.messages = self.bytes = 0
        self.more = False

    def receive(self, message: bytes) -> None:
        self.messages, self.bytes = self.messages + 1, self.bytes + len(message)
        header, arrays = decode(message)
        if "run_info" in header and header["run_info"]["session"] != self.run_info.get("session"):
            messages, sent = self.messages, self.bytes
            self.__init__()
            self.messages, self.bytes = messages, sent
        self.run_info, self.status = header.get("run_info", self.run_info), header.get("status", self.status)
        self.reported = header.get("messages", self.reported)
        if header.get("clear"):
            self.tiles = {}
        if "tiles" in arrays:
            self.tiles.update(zip(map(tuple, arrays["tiles_at"].tolist()), unpack_tiles(arrays["tiles"]), strict=True))
        if "path" in arrays:
            self.path = np.concatenate([self.path[: header["path"]], arrays["path"]])
        if "series" in arrays:
            self.series = np.concatenate([self.series[: header["series"]], arrays["series"]])
        self.arrays.update(arrays)
        self.more = header.get("more", False)

    def catch_up(self, viewer: Any) -> None:
        """Take all messages that there are."""
        while (message := viewer.next_message()) is not None:
            self.receive(message)

    def sees(self, grid: OccupancyGrid) -> bool:
        """Whether the map looks like this one, cell by cell."""
        replica = TileReplica()
        replica.apply(split_into_tiles(grid))
        at, looks, _ = replica.since(0, 10**9)
        tiles = zip(map(tuple, at.tolist()), unpack_tiles(looks), strict=True)
        expected = {where: look for where, look in tiles if look.any()}
        seen = {where: look for where, look in self.tiles.items() if look.any()}
        return expected.keys() == seen.keys() and all(np.array_equal(seen[where], expected[where]) for where in seen)


def decode(message: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Read a message: its header, and its arrays by name."""
    data = zlib.decompress(message)
    start = 4 + struct.unpack_from("<I", data)[0]
    header: dict[str, Any] = json.loads(data[4:start])
    arrays = {}
    for name, kind, shape in header.pop("arrays"):
        dtype, count = np.dtype(f"<{kind}"), int(np.prod(shape))
        arrays[name] = np.frombuffer(data, dtype, count, start).reshape(shape)
        start += (count * dtype.itemsize + 3) // 4 * 4
    return header, arrays


def unpack_tiles(data: np.ndarray) -> np.ndarray:
    """Levels (K, 32, 32) from `pack_tiles` ones."""
    return np.stack([data & 15, data >> 4], axis=-1).reshape(len(data), TILE, TILE)
