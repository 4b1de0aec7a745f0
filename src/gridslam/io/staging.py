"""Temporary folders from which files are published: locked while their process lives, and removed by the next one."""

from __future__ import annotations

import errno
import os
import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import final

try:
    import fcntl
except ImportError:  # Windows has no such locks: there nothing is removed
    fcntl = None  # type: ignore[assignment]

_PARTIAL = re.compile(r"\..+\.\w{8}\.partial")


@final
class StagingFolder:
    """A folder `.NAME.XXXXXXXX.partial` of its own for a file or folder NAME.

    It is locked as long as this process lives, and removed at its end wherever an interrupt has come. Those that were
    left by killed processes are removed first.

    Parameters
    ----------
    parent : Path
        Folder in which it is created.
    name : str
        NAME.

    Attributes
    ----------
    path : Path
        The folder.

    Raises
    ------
    OSError
        The folder cannot be created.
    """

    def __init__(self, parent: Path, name: str) -> None:
        """Remove abandoned folders, and create this one."""
        remove_abandoned(parent)
        while True:
            self._folder = TemporaryDirectory(".partial", f".{name}.", parent, ignore_cleanup_errors=True)
            self.path = Path(self._folder.name)
            self._lock = _lock(self.path)
            if self.path.exists():  # else another process has removed it before it was locked
                return
            self.remove()

    def remove(self) -> None:
        """Remove the folder and all in it."""
        self._folder.cleanup()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def remove_abandoned(folder: Path) -> None:
    """Remove half-written files of killed processes from a folder."""
    for left in folder.iterdir():
        if _PARTIAL.fullmatch(left.name) and (lock := _lock(left)) is not None:
            shutil.rmtree(left, ignore_errors=True)
            os.close(lock)


def sync(*paths: Path) -> None:
    """Wait until files, or the names in folders, are stored: they survive a loss of power from now on."""
    for path in paths:
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except OSError:  # folders cannot be opened everywhere
            continue
        try:
            os.fsync(descriptor)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):  # what is no storage need not be synced
                raise
        finally:
            os.close(descriptor)


def _lock(path: Path) -> int | None:
    """Lock a folder for this process; None if it is locked, or cannot be."""
    if fcntl is None:
        return None
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor
