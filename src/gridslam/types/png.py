"""A grey picture as PNG, without a library for images."""

from __future__ import annotations

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

__all__ = ["encode_grey"]


def encode_grey(pixels: NDArray[np.uint8]) -> bytes:
    """PNG of brightnesses (H, W), both at least 1, the first row at the top.

    Source: PNG specification, third edition, sections 5.2 to 5.6, 9.2 and 11.2.
    """
    height, width = pixels.shape
    lines = np.pad(pixels, [(0, 0), (1, 0)])  # each line begins with its filter: 0, none
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(lines.tobytes())), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, data) for kind, data in chunks)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
