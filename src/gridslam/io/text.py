"""Lines of a possibly compressed text file, a block at a time; distinguishes truncated from damaged files."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import os
import re
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import IO, cast, final

from gridslam.errors import InputError

__all__ = ["TextSource", "compute_sha256", "open_for_reading", "read_head", "read_text"]

_BLOCK_BYTES = 1 << 17  # some hundred scans: large enough to parse in one go, small enough to stream
_LONGEST_LINE_BYTES = 1 << 20
_NOT_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


def open_for_reading(path: str | Path) -> IO[bytes]:
    """Open a file that must exist, be a file and hold something; raises InputError otherwise."""
    where = Path(path)
    if where.is_dir():
        raise InputError(path, "expected a file, got a directory")
    try:
        file = where.open("rb")
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except OSError as error:
        raise InputError(path, f"cannot be opened: {error.strerror}") from None
    if os.fstat(file.fileno()).st_size == 0:
        file.close()
        raise InputError(path, "the file is empty")
    return file


def read_text(path: str | Path) -> str:
    """Read a whole small UTF-8 text file; raises InputError where it is none."""
    with open_for_reading(path) as file:
        try:
            return file.read().decode("utf-8")
        except UnicodeDecodeError:
            raise InputError(path, "expected a text file, got binary data") from None


def read_head(path: str | Path, size: int) -> bytes:
    """First bytes of a file, decompressed; fewer than `size` where it is shorter, cut off or damaged."""
    head = b""
    with open_for_reading(path) as file, _decompressed(file) as stream:
        try:
            while len(head) < size and (chunk := stream.read1(size - len(head))):  # type: ignore[attr-defined]
                head += chunk
        except (EOFError, OSError, zlib.error):
            pass  # the reader reports it
    return head


def compute_sha256(path: str | Path) -> str:
    """SHA-256 of the file's bytes as they stand on disk (compressed where it is), in hexadecimal."""
    digest = hashlib.sha256()
    with open_for_reading(path) as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def _decompressed(file: IO[bytes]) -> IO[bytes]:
    """Undo the compression detected from the first bytes, whatever the name of the file."""
    magic = file.read(3)
    file.seek(0)
    if magic == b"BZh":
        return bz2.BZ2File(file)
    if magic[:2] == b"\x1f\x8b":
        return cast(IO[bytes], gzip.GzipFile(fileobj=file))
    return file


@final
class TextSource:
    """Iterates over lists of lines (without their line ends), in file order.

    Attributes
    ----------
    total_bytes, bytes_read : int
        Size of the file and how much of it has been read, both as on disk.
    is_truncated : bool
        True once the compressed stream has ended before its end mark.
    unterminated : bool
        True once the last line has been given and no line end followed it.
    """

    def __init__(self, path: str | Path) -> None:
        """Check that there is a file with something in it."""
        self.path = Path(path)
        with open_for_reading(path) as file:
            self.total_bytes = os.fstat(file.fileno()).st_size
        self.bytes_read = 0
        self.is_truncated = False
        self.unterminated = False

    def __iter__(self) -> Iterator[list[str]]:
        """Yield blocks of lines; raises InputError for binary, damaged or unreadable files."""
        rest = b""
        for chunk in self._chunks():
            text = rest + chunk
            end = text.rfind(b"\n") + 1
            rest = text[end:]
            if len(rest) > _LONGEST_LINE_BYTES:
                raise InputError(self.path, f"expected text, got a line of more than {_LONGEST_LINE_BYTES} bytes")
            if end:
                yield text[: end - 1].decode("latin-1").split("\n")
        if rest:
            self.unterminated = True
            yield [rest.decode("latin-1")]

    def _chunks(self) -> Iterator[bytes]:
        with ExitStack() as stack:
            file = stack.enter_context(open_for_reading(self.path))
            stream = stack.enter_context(_decompressed(file))
            while chunk := self._read(stream):
                if self.bytes_read == 0 and _NOT_TEXT.search(chunk):
                    raise InputError(self.path, "expected a text file, got binary data")
                self.bytes_read = file.tell()
                yield chunk
            self.bytes_read = file.tell()

    def _read(self, stream: IO[bytes]) -> bytes:
        try:
            return stream.read1(_BLOCK_BYTES)  # type: ignore[attr-defined, no-any-return]
        except EOFError:
            self.is_truncated = True
            return b""
        except (OSError, zlib.error) as error:
            raise InputError(self.path, f"the file is damaged and cannot be read further: {error}") from None
