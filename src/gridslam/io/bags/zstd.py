"""Zstandard, in which ROS 2 compresses the messages or the files of a bag."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

from gridslam.io.bags.source import DamageError

__all__ = ["decompress", "is_compressed", "unpack"]

_MAGIC = b"\x28\xb5\x2f\xfd"
_BLOCK_BYTES = 1 << 20


def is_compressed(data: bytes) -> bool:
    """Detect it by the first bytes."""
    return data.startswith(_MAGIC)


def decompress(data: bytes, size: int = -1) -> bytes:
    """Decompress `data`, to `size` bytes at most if that is given, and to less where they are cut off.

    Raises DamageError where they are damaged.
    """
    zstd = _module()
    try:
        found: bytes = zstd.ZstdDecompressor().decompress(data, size)
        return found
    except (zstd.ZstdError, EOFError, ValueError, MemoryError) as error:
        raise DamageError(f"its data cannot be decompressed: {error}") from None


def unpack(packed: Path, target: Path) -> str:
    """Decompress a file into another; returns why the latter is not whole, or an empty text."""
    zstd = _module()
    with target.open("wb") as file:
        try:
            with zstd.open(packed, "rb") as stream:
                while block := stream.read1(_BLOCK_BYTES):
                    file.write(block)
        except (zstd.ZstdError, EOFError, MemoryError) as error:
            return f"it cannot be decompressed to its end: {error}"
    return ""


def _module() -> Any:  # noqa: ANN401
    """The module of the standard library, or what stands in for it before Python 3.14 and comes with rosbags."""
    return importlib.import_module("compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd")
