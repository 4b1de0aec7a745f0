"""Standard input, output and error of a command, also if they are closed, full, or of a limited encoding."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Any, TextIO, final


def open_streams(*, own_process: bool) -> None:
    """Make standard output and error able to print any text; in a process of its own, also where they are closed.

    What is closed becomes the null device: the next file that is opened would take its place. Nothing that is printed
    on standard error fails, as the results are more than who looks on.
    """
    if own_process:
        for descriptor in range(3):
            _open_if_closed(descriptor)
        sys.stdin = sys.stdin or open(0)  # noqa: SIM115
        sys.stdout = _wrap(_Output(1, "wb", closefd=False), sys.stdout)
        sys.stderr = _wrap(_Unfailing(2, "wb", closefd=False), sys.stderr)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name of a file may hold bytes that are no text
            stream.reconfigure(errors="backslashreplace")


def close_output() -> OSError | ValueError | None:
    """Flush standard output; return the reason if that is not possible.

    Then it becomes the null device, as Python would try again when it ends.
    """
    try:
        sys.stdout.flush()
    except (OSError, ValueError) as error:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error
    return None


@final
class _Output(io.FileIO):
    """Standard output, which errors name."""

    def write(self, data: Any) -> int:  # noqa: ANN401
        try:
            return super().write(data)
        except OSError as error:
            raise OSError(error.errno, error.strerror, "standard output") from None


@final
class _Unfailing(io.FileIO):
    """A file that drops text that cannot be written."""

    def write(self, data: Any) -> int:  # noqa: ANN401
        try:
            return super().write(data)
        except OSError:
            return len(data)


def _wrap(raw: io.FileIO, before: TextIO | None) -> io.TextIOWrapper:
    """Return a text stream with the encoding of the one before, if there was one."""
    encoding = "utf-8" if before is None else before.encoding
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding, line_buffering=raw.fileno() == 2 or raw.isatty())


def _open_if_closed(descriptor: int) -> None:
    try:
        os.fstat(descriptor)
    except OSError:
        os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # the lowest number that is free: this one
