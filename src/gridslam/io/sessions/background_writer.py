"""Write sessions in a thread of their own while the filter continues."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import final

from gridslam.errors import GridslamError
from gridslam.io.sessions.session_file import SavedSession, write_session
from gridslam.pipeline import describe_error

_NICE = 10


def lower_priority() -> None:
    """Let this thread give way to all others, where the system knows priorities of threads."""
    if sys.platform == "linux":
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)


@final
class BackgroundWriter:
    """Writes one session at a time; the filter waits only while its tables are copied.

    A process that ends, be it by a signal, waits until what is being written is whole.

    Parameters
    ----------
    on_failure : callable
        Called with what has failed, such as a full disk, from `report`.
    """

    def __init__(self, on_failure: Callable[[str], None] = lambda problem: None) -> None:
        self._on_failure = on_failure
        self._thread: threading.Thread | None = None
        self._problem = ""

    @property
    def is_busy(self) -> bool:
        """Whether a session is being written."""
        return self._thread is not None and self._thread.is_alive()

    def write(self, path: Path, session: SavedSession) -> None:
        """Write a session as it is now, in place of an earlier one; call between two scans, and when it is idle."""
        run = session.run
        try:
            copied = [replace(session, run=None if run is None else run.copy())]  # dropped by the thread that writes it
        except MemoryError as error:
            self._problem = describe_error(error)
            return
        self._thread = threading.Thread(target=self._write, args=(path, copied), name="gridslam-autosave")
        self._thread.start()

    def report(self) -> None:
        """Report failures since the last call."""
        problem, self._problem = self._problem, ""
        if problem:
            self._on_failure(problem)

    def close(self) -> None:
        """Wait for the file being written, and report failures."""
        if self._thread is not None:
            self._thread.join()
        self.report()

    def _write(self, path: Path, copied: list[SavedSession]) -> None:
        lower_priority()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_session(path, copied.pop())
        except (OSError, GridslamError, MemoryError) as error:
            self._problem = describe_error(error)
