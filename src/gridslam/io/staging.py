"""Temporary folders from which files are published: locked while their process lives, and removed by the next one."""

from __future__ import annotations

import ctypes
import errno
import os
import re
import secrets
import shutil
import weakref
from pathlib import Path
from typing import Final, final

try:
    import fcntl
except ImportError:  # Windows has no such locks: there nothing is removed
    fcntl = None  # type: ignore[assignment]

REPLACED: Final = ".replaced"
"""Folder within a staging folder for the files that are being replaced; it shows that publishing had begun."""

_PARTIAL = re.compile(r"\..+\.[0-9a-f]{8}\.partial")
_EXCHANGE = 2  # RENAME_EXCHANGE of renameat2
_HERE = -100  # AT_FDCWD


@final
class StagingFolder:
    """A folder `.NAME.XXXXXXXX.partial` of its own for a file or folder NAME.

    It is locked as long as this process lives, and removed at its end wherever an interrupt has come. Those that were
    left by killed processes are removed first; one whose files were being moved into the folder `target` is completed.

    Parameters
    ----------
    parent : Path
        Folder in which it is created.
    name : str
        NAME.
    target : Path, optional
        Folder in which the files are published.

    Attributes
    ----------
    path : Path
        The folder.

    Raises
    ------
    OSError
        The folder cannot be created.
    """

    def __init__(self, parent: Path, name: str, target: Path | None = None) -> None:
        """Remove abandoned files, and create the folder."""
        for left in parent.glob(f".{_escape(name)}.????????.partial"):
            _remove_unless_locked(left, target)
        while True:
            self.path = parent / f".{name}.{secrets.token_hex(4)}.partial"
            self._last_removal = weakref.finalize(self, _remove_own, self.path, os.getpid())
            self.path.mkdir()
            self._lock = _lock(self.path)
            if self.path.exists():  # else another process has removed it before it was locked
                return
            self._last_removal.detach()
            self._unlock()

    def remove(self) -> None:
        """Remove the folder and all in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        self._last_removal.detach()
        self._unlock()

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def remove_abandoned(folder: Path) -> None:
    """Remove half-written files of killed processes from a folder."""
    for left in folder.iterdir():
        if _PARTIAL.fullmatch(left.name):
            _remove_unless_locked(left, None)


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


def exchange_folders(a: Path, b: Path) -> bool:
    """Exchange two folders in one step; returns False where the system cannot."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return bool(rename(_HERE, os.fsencode(a), _HERE, os.fsencode(b), _EXCHANGE) == 0)


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


def _remove_own(path: Path, process: int) -> None:
    """Remove a folder at the end of the process that has created it; a process that was forked from it leaves it."""
    if os.getpid() == process:
        shutil.rmtree(path, ignore_errors=True)


def _remove_unless_locked(left: Path, target: Path | None) -> None:
    """Remove a staging folder unless its process is alive; complete a move of its files that was interrupted."""
    lock = _lock(left)
    if lock is None:
        return
    try:
        if target is not None and (left / REPLACED).is_dir() and target.is_dir():
            for file in left.iterdir():
                if file.name != REPLACED:
                    os.replace(file, target / file.name)
        shutil.rmtree(left, ignore_errors=True)
    except OSError:  # whoever may, removes it
        return
    finally:
        os.close(lock)


def _escape(name: str) -> str:
    """Escape the special characters of a pattern."""
    return "".join(f"[{letter}]" if letter in "*?[" else letter for letter in name)
