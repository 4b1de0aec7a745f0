"""Bytes and lines of files, compressed or not, a block at a time; distinguishes truncated from damaged files."""

from __future__ import annotations

import bz2
import gzip
import hashlib
import json
import os
import re
import stat
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import IO, Any, cast, final

from gridslam.arguments import require_plain
from gridslam.errors import InputError, describe_failure
from gridslam.io.limits import UnpackingLimit, describe_bytes

_BLOCK_BYTES = 1 << 17  # some hundred scans: large enough to parse in one go, small enough to stream
_LONGEST_LINE_BYTES = 1 << 20
_LARGEST_TEXT_BYTES = 1 << 26
_NOT_TEXT = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


def open_for_reading(path: str | Path) -> IO[bytes]:
    """Open a file that must exist, be a regular file and hold something; raises InputError otherwise.

    Pipes, devices and sockets are refused: files are read more than once, and what comes of a pipe is there only once.
    """
    try:
        mode = os.stat(path).st_mode  # looked at first: who opens a pipe waits for its other end
        if stat.S_ISDIR(mode):
            raise InputError(path, "expected a file, got a directory")
        if not stat.S_ISREG(mode):
            raise InputError(path, "expected a file, got a pipe or a device: write what it gives to a file first")
        file = open(path, "rb")  # noqa: SIM115 the caller closes it
    except FileNotFoundError:
        raise InputError(path, "no such file") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a zero byte in it
        raise InputError(path, f"cannot be opened: {getattr(error, 'strerror', None) or error}") from None
    if os.fstat(file.fileno()).st_size:
        return file
    file.close()
    raise InputError(path, "the file is empty")


@contextmanager
def refuse_unreadable(path: str | Path, expected: str) -> Iterator[None]:
    """Convert any exception of a parser within the context to an InputError that names the file.

    Parsers raise errors of any type on damaged or hostile content: by this, all of them become the one line that a user
    gets. Where an error knows its line as `line` or `lineno`, from 1, the line is named, too.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        line = getattr(error, "line", None) or getattr(error, "lineno", None)
        raise InputError(path, f"expected {expected}, got: {describe_failure(error)}", line) from None


def read_text(path: str | Path, most: int = _LARGEST_TEXT_BYTES) -> str:
    """Read a whole small UTF-8 text file; raises InputError where it is none, or larger than `most` bytes."""
    with open_for_reading(path) as file:
        text = file.read(most + 1)
    if len(text) > most:
        raise InputError(path, f"expected a text file of at most {describe_bytes(most)}, got a larger one")
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(path, "expected a text file, got binary data") from None


def parse_json(text: str | bytes, *, odd_names: bool = False) -> Any:  # noqa: ANN401
    """Read JSON; raises an error of any kind for invalid text, or for values that `require_plain` rejects."""
    document = json.loads(text)
    require_plain(document, odd_names=odd_names)
    return document


def read_json(path: str | Path) -> dict[str, Any]:
    """Read a JSON object; raises InputError, with the line, where the file holds none."""
    return parse_json_object(read_text(path), path, odd_names=True)


def parse_json_object(text: str | bytes, path: str | Path, *, odd_names: bool = False) -> dict[str, Any]:
    """Read a JSON object, as `read_json`; `path` names the file in errors."""
    with refuse_unreadable(path, "JSON"):
        document = parse_json(text, odd_names=odd_names)
    if not isinstance(document, dict):
        raise InputError(path, f"expected a JSON object, got a {type(document).__name__}")
    return document


def read_head(path: str | Path, size: int) -> bytes:
    """Return first bytes of a file, decompressed; fewer than `size` where it is shorter, cut off or damaged."""
    head = b""
    with open_for_reading(path) as file, _decompressed(file) as stream:
        try:
            while len(head) < size and (chunk := stream.read1(size - len(head))):  # type: ignore[attr-defined]
                head += chunk
        except (EOFError, OSError, zlib.error):
            pass  # the reader reports it
    return head


def compute_digest(path: str | Path) -> str:
    """Compute the SHA-256, in hexadecimal, of the bytes of a file on disk, or of the content of a folder.

    Of a folder it is the SHA-256 of lines `<SHA-256 of the file>  <path in the folder>`, as `sha256sum` writes them,
    one for each file below it that is not empty, sorted by path: where the folder stands does not matter. Raises
    InputError where there is nothing at `path` or a file cannot be read.
    """
    where = Path(path)
    digest = hashlib.sha256()
    if where.is_dir():
        files = {file.relative_to(where).as_posix(): file for file in where.rglob("*") if file.is_file()}
        for name, file in sorted(files.items()):
            if file.stat().st_size:
                digest.update(f"{compute_digest(file)}  ".encode() + os.fsencode(name) + b"\n")
    else:
        with open_for_reading(where) as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def measure_size(path: Path) -> int:
    """Return bytes of a file, or of all files in a folder; raises InputError if it is absent."""
    try:
        files = path.rglob("*") if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files if not file.is_dir())
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}") from None


def read_numbered_lines(path: str | Path, *, with_comments: bool = False) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text file with their numbers, from 1.

    Blank lines and those that begin with # are left out, unless `with_comments`. Raises InputError where the file
    cannot be read, or ends in the middle.
    """
    source = TextSource(path)
    number = 0
    for number, line in enumerate(chain.from_iterable(source), 1):
        if source.is_truncated:  # what is left of a line
            break
        text = line.rstrip("\r")
        text = text.removeprefix("\xef\xbb\xbf") if number == 1 else text  # what some programs put before UTF-8
        if with_comments or (text.strip() and not text.lstrip().startswith("#")):
            yield number, text
    if source.is_truncated:
        raise InputError(path, "the compressed file ends in the middle", number)


def _decompressed(file: IO[bytes]) -> IO[bytes]:
    """Undo the compression that the first bytes of a file show, independent of its name."""
    magic = file.read(3)
    file.seek(0)
    if magic == b"BZh":
        return bz2.BZ2File(file)
    return cast(IO[bytes], gzip.GzipFile(fileobj=file)) if magic[:2] == b"\x1f\x8b" else file


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
        blank = 0
        for chunk, bytes_read, is_truncated in self._chunks():
            self.bytes_read, self.is_truncated = bytes_read, is_truncated
            blank = blank + len(chunk) if chunk.isspace() else 0
            if blank > _LONGEST_LINE_BYTES:
                raise InputError(self.path, f"expected text, got blank lines of more than {_LONGEST_LINE_BYTES} bytes")
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

    def _chunks(self) -> Iterator[tuple[bytes, int, bool]]:
        limit = UnpackingLimit(self.total_bytes)
        is_first = True
        with (
            open_for_reading(self.path) as file,
            _decompressed(file) as stream,
            ThreadPoolExecutor(1, "gridslam-read") as reader,  # a block ahead: decompression leaves Python's lock free
        ):

            def read() -> tuple[bytes | None, int]:
                return self._read(stream), file.tell()

            ahead = reader.submit(read)
            while True:
                chunk, bytes_read = ahead.result()
                if not chunk:
                    break
                ahead = reader.submit(read)
                if not limit.take(len(chunk)):
                    raise InputError(self.path, limit.problem)
                if is_first and _NOT_TEXT.search(chunk):
                    raise InputError(self.path, "expected a text file, got binary data")
                is_first = False
                yield chunk, bytes_read, False
            yield b"", bytes_read, chunk is None

    def _read(self, stream: IO[bytes]) -> bytes | None:
        """Read a block; none at the end, None where the compressed stream ends without its end mark."""
        try:
            return stream.read1(_BLOCK_BYTES)  # type: ignore[attr-defined, no-any-return]
        except EOFError:
            return None
        except (OSError, zlib.error) as error:
            raise InputError(self.path, f"the file is damaged and cannot be read further: {error}") from None
