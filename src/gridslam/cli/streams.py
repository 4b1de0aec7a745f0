"""Standard input, output and error of a command, whatever they are: closed, full, or in an encoding without letters."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress
from typing import Any, final

__all__ = ["close_output", "open_streams"]


def open_streams(*, own_process: bool) -> None:
    """Make standard output and error able to print any text; in a process of its own, also where they are closed.

    What is closed becomes the null device: the next file that is opened would take its place. Nothing that is printed
    on standard error fails, as the results are more than who looks on.
    """
    if own_process:
        for descriptor in range(3):
            _open_if_closed(descriptor)
        sys.stdin = sys.stdin or open(0)
        sys.stdout = sys.stdout or open(1, "w", encoding="utf-8")
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(_Unfailing(2, "wb", closefd=False)),
            encoding=getattr(sys.stderr, "encoding", "utf-8"),
            line_buffering=True,
        )
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a name of a file may hold bytes that are no text
            stream.reconfigure(errors="backslashreplace")


def close_output() -> str:
    """Write what is still to be printed on standard output; return why that is not possible, or an empty text.

    Then it becomes the null device, as Python would try again when it ends.
    """
    try:
        sys.stdout.flush()
    except (OSError, ValueError) as error:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return "" if isinstance(error, BrokenPipeError) else f"standard output: cannot be written: {error}"
    return ""


@final
class _Unfailing(io.FileIO):
    """A file that drops what cannot be written."""

    def write(self, data: Any) -> int:  # noqa: ANN401
        try:
            return super().write(data) or len(data)
        except OSError:
            return len(data)


def _open_if_closed(descriptor: int) -> None:
    try:
        os.fstat(descriptor)
    except OSError:
        os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
