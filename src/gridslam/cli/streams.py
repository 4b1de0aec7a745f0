"""Standard input, output and error of a command, also if they are closed, full, or of a limited encoding."""

from __future__ import annotations

import io
import os
import sys
from contextlib import suppress


def open_streams() -> None:
    """Make standard output and error able to print any text, as names of files may hold bytes that are no text.

    What is closed becomes the null device, here and in child processes: the next file that is opened would take its
    place.
    """
    for name in ("stdin", "stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            stream = open(os.devnull, "r" if name == "stdin" else "w")  # noqa: SIM115
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)
        elif isinstance(stream, io.TextIOWrapper):
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
