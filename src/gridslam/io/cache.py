"""Copies of remote logs on this machine: complete or absent, and the least recently used go first."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

from gridslam.errors import InputError, OutputError
from gridslam.io.limits import describe_bytes
from gridslam.io.staging import StagingFolder
from gridslam.io.text import compute_digest, measure_size

try:
    import fcntl
except ImportError:  # Windows has no such locks: there nothing that is in use is protected
    fcntl = None  # type: ignore[assignment]

__all__ = ["CACHE", "CACHE_GB", "Cached", "LogCache", "find_origin"]

CACHE = "GRIDSLAM_CACHE"
"""Variable of the environment that names the folder of the cache."""

CACHE_GB = "GRIDSLAM_CACHE_GB"
"""Variable of the environment that limits its size, in GB."""

_DEFAULT_GB = 20.0
_ENTRY = "entry.json"
_NAME_LETTERS = 60
_used: dict[Path, int | None] = {}
"""Entries that this process uses, with the descriptor of their lock."""


@final
@dataclass(frozen=True)
class Cached:
    """Copy of a remote log.

    Attributes
    ----------
    path : Path
        The copy: a file, or a folder.
    sha256 : str
        Of its content, in hexadecimal (see `compute_digest`).
    """

    path: Path
    sha256: str


@final
@dataclass(frozen=True)
class LogCache:
    """A folder of copies.

    Parameters
    ----------
    folder : Path
        Where they are; created if missing.
    limit_bytes : int
        What all of them may take. Those that were not used for the longest time are removed; never one that a living
        process uses.
    """

    folder: Path
    limit_bytes: int

    @classmethod
    def default(cls) -> LogCache:
        """The cache of this user, as the environment sets it (`CACHE`, `CACHE_GB`; 20 GB in ~/.cache/gridslam)."""
        above = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = Path(os.environ.get(CACHE) or Path(above) / "gridslam" / "logs")
        text = os.environ.get(CACHE_GB) or str(_DEFAULT_GB)
        try:
            limit = float(text)
        except ValueError:
            limit = -1.0
        if not 0 < limit < 1e9:
            raise InputError(CACHE_GB, f"expected a number of GB above 0, got {text!r}")
        return cls(folder, round(limit * 1e9))

    def require_size(self, size: int, name: str) -> None:
        """Raise InputError where a log is larger than the whole cache."""
        if size > self.limit_bytes:
            limit = describe_bytes(self.limit_bytes)
            raise InputError(name, f"{describe_bytes(size)} do not fit in the cache of {limit} ({CACHE_GB})")

    def get(self, origin: str, state: str, download: Callable[[Path], Path]) -> Cached:
        """Return the copy of a log; it is downloaded if there is none of this state.

        Parameters
        ----------
        origin : str
            URL of the log, without credentials.
        state : str
            What distinguishes this content of the URL from another.
        download : callable
            Writes the log into a folder, and returns its path there.

        Raises
        ------
        OutputError
            The cache cannot be written.
        """
        digest = hashlib.sha256(f"{origin}\n{state}".encode()).hexdigest()
        stem = re.sub(r"[^A-Za-z0-9.-]+", "_", origin.partition("://")[2]).strip("._")[-_NAME_LETTERS:]
        entry = self.folder / f"{stem}-{digest[:16]}"
        try:
            found = self._open(entry)
            if found is None:
                self.folder.mkdir(parents=True, exist_ok=True)
                self._download(entry, origin, download)
                found = self._open(entry)
            if found is None:
                raise OutputError(f"{entry}: cannot be written: another process removed it")
            self._evict()
        except OSError as error:
            raise OutputError(f"{self.folder}: cannot be written: {error.strerror or error}") from None
        return found

    def _open(self, entry: Path) -> Cached | None:
        """Lock an entry for the life of this process, and note its use; None where there is none."""
        if entry not in _used:
            descriptor = _lock(entry, exclusive=False)
            if descriptor is None and fcntl is not None:
                return None
            _used[entry] = descriptor
        try:
            description = json.loads((entry / _ENTRY).read_text(encoding="utf-8"))
            found = Cached(entry / description["name"], description["sha256"])
        except (OSError, ValueError, KeyError):
            _release(entry)
            return None
        if not found.path.exists():
            _release(entry)
            return None
        with suppress(OSError):
            os.utime(entry / _ENTRY)
        return found

    def _download(self, entry: Path, origin: str, download: Callable[[Path], Path]) -> None:
        """Make an entry at once; if another process has made it in the same interval, that one stays."""
        staging = StagingFolder(self.folder, entry.name)
        try:
            inner = staging.path / "entry"
            inner.mkdir()
            path = download(inner)
            size = measure_size(inner)
            self.require_size(size, origin)
            description = {"origin": origin, "name": path.name, "sha256": compute_digest(path), "bytes": size}
            (inner / _ENTRY).write_text(json.dumps(description), encoding="utf-8")
            if entry.exists() and self._open(entry) is None:
                shutil.rmtree(entry, ignore_errors=True)  # damaged
            with suppress(FileExistsError, NotADirectoryError):
                try:
                    os.rename(inner, entry)
                except OSError:
                    if not entry.exists():
                        raise
        finally:
            staging.remove()

    def _evict(self) -> None:
        """Remove the entries of the longest time without use until all fit."""
        entries = sorted(self._entries())
        total = sum(size for _, size, _ in entries)
        for _, size, entry in entries:
            if total <= self.limit_bytes:
                return
            if entry in _used:
                continue
            descriptor = _lock(entry, exclusive=True)
            if descriptor is None and fcntl is not None:
                continue  # another process uses it
            shutil.rmtree(entry, ignore_errors=True)
            if descriptor is not None:
                os.close(descriptor)
            total -= size

    def _entries(self) -> Iterator[tuple[int, int, Path]]:
        """Yield time of the last use, size and folder of each entry."""
        for description in self.folder.glob(f"*/{_ENTRY}"):
            with suppress(OSError, ValueError, KeyError):
                size = int(json.loads(description.read_text(encoding="utf-8"))["bytes"])
                yield description.stat().st_mtime_ns, size, description.parent


def find_origin(path: Path) -> str | None:
    """URL, without credentials, of which a path is the copy; None where it is no copy."""
    with suppress(OSError, ValueError):
        description: dict[str, Any] = json.loads((path.parent / _ENTRY).read_text(encoding="utf-8"))
        if isinstance(description, dict) and description.get("name") == path.name:
            return str(description.get("origin"))
    return None


def _lock(entry: Path, *, exclusive: bool) -> int | None:
    """Lock an entry; None where there is none, or another process uses it."""
    if fcntl is None:
        return None
    try:
        descriptor = os.open(entry, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
        if os.fstat(descriptor).st_ino == os.stat(entry).st_ino:
            return descriptor
    except OSError:
        pass
    os.close(descriptor)
    return None


def _release(entry: Path) -> None:
    descriptor = _used.pop(entry, None)
    if descriptor is not None:
        os.close(descriptor)
