"""Results are written to a temporary folder and then renamed, so that a run leaves all of its files or none."""

from __future__ import annotations

import bz2
import errno
import gzip
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import IO, Any, cast, final

from gridslam.errors import ArgumentError, OutputError

_LAST = "run.json"
_RANDOM = "[!.]" * 8
"""Pattern of the part that `tempfile` draws: .NAME.2.XXXXXXXX.partial belongs to NAME.2."""


def require_writable(path: Path, *, is_folder: bool) -> None:
    """Check that a file or a folder of this path can be made or replaced, by making it in a temporary folder.

    Raises
    ------
    OutputError
        Something else is in its place or in that of a folder above it, or it cannot be written there.
    """
    above = _find_folder(path, path if is_folder else path.parent)
    if not is_folder and os.path.exists(path) and not path.is_file():
        got = "an existing folder" if path.is_dir() else "a device or a pipe"
        raise OutputError(f"{path}: expected the name of a file, got {got}")
    try:
        with _Staging(above, path.name) as folder:
            Path(folder, path.relative_to(above)).mkdir(parents=True, exist_ok=True)  # whether there can be such names
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


@final
class _Staging(TemporaryDirectory[str]):
    """A folder .NAME.XXXXXXXX.partial from which NAME is published.

    It is removed when the process ends at the latest, also where an interrupt comes while it is made or removed.
    """

    def __init__(self, parent: Path, name: str) -> None:
        try:
            super().__init__(".partial", f".{name}.", parent, ignore_cleanup_errors=True)
        except KeyboardInterrupt:  # the folder may be there already, though its name was not returned
            for left in _find_staging(parent, name):
                with suppress(OSError):  # what holds something is another process's
                    left.rmdir()
            raise

    def cleanup(self) -> None:
        """Remove the folder; later interrupts do not disturb it (see `gridslam.cli.output.handle_signals`)."""
        try:
            super().cleanup()
        finally:
            shutil.rmtree(self.name, ignore_errors=True)


def _find_staging(folder: Path, name: str) -> Iterator[Path]:
    """Find the temporary folders of NAME, or of all names."""
    return folder.glob(f".{escape(name) or '*'}.{_RANDOM}.partial")


def remove_abandoned(folder: Path, name: str = "") -> None:
    """Remove the temporary folders of killed processes: those of NAME, or of all names."""
    for left in _find_staging(folder, name):
        shutil.rmtree(left, ignore_errors=True)


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


def _find_folder(path: Path, folder: Path) -> Path:
    """Find the folder that `path` is to be written to, or the nearest one above it that there is."""
    while not os.path.lexists(folder) and folder != folder.parent:
        folder = folder.parent
    if not folder.exists():
        raise OutputError(f"{path}: expected a folder to write to, but {folder} is a link to nothing")
    if not folder.is_dir():
        raise OutputError(f"{path}: expected a folder to write to, but {folder} is a file")
    return folder


@contextmanager
def write_atomically(path: str | Path) -> Iterator[Path]:
    """Give a path near `path` to write a file or a folder to; it becomes `path` at the end unless an exception passes.

    Folders above it are made where there are none.
    """
    target = Path(path)
    staging: _Staging | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        staging = _Staging(target.parent, target.name)
        aside = Path(staging.name, target.name)
        yield aside
        sync(*aside.rglob("*"), aside)
        os.replace(aside, target)
        sync(target.parent)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        if staging is not None:
            staging.cleanup()


@contextmanager
def open_for_writing(path: Path, suffix: str) -> Iterator[IO[bytes]]:
    """Open a file whose bytes are compressed where `suffix` is .gz or .bz2."""
    with path.open("wb") as raw:
        if suffix == ".gz":
            # Neither name nor time is stored in the file, so that the same log gives an identical file.
            with gzip.GzipFile(filename="", mode="wb", fileobj=raw, mtime=0) as file:
                yield cast(IO[bytes], file)
        elif suffix == ".bz2":
            with bz2.BZ2File(raw, "wb") as compressed:
                yield compressed
        else:
            yield raw


@final
class OutputFolder:
    """The folder OUT of a run; a context manager: write to the paths that `file` returns.

    When the context is left without an exception the files move into OUT, replacing those of the same names; other
    files in OUT stay. When an exception passes (an interrupt too), OUT is as it was before. A new folder appears whole.
    In one that exists the earlier run.json goes first and the new one comes last: where there is one, all files are of
    its run, even after a process was killed.

    Parameters
    ----------
    path : str or Path
        OUT; it and the folders above it are made where there are none.
    names : sequence of str
        Names of files that will be written, to check on entering that no folder is in their way.

    Raises
    ------
    OutputError
        On entering, where OUT is a file or cannot be written, or a folder has the name of a file; on leaving, where a
        file cannot be moved into it.
    """

    def __init__(self, path: str | Path, names: Sequence[str] = ()) -> None:
        """Name the folder; nothing is touched before the context is entered."""
        self.path = Path(path)
        self._names = names
        self._staging: _Staging | None = None

    def __enter__(self) -> OutputFolder:
        """Check that OUT can be written and create the temporary folder, in OUT or else in the folder above."""
        above = _find_folder(self.path, self.path)
        try:
            self._require_no_folders(self._names)
            self._staging = _Staging(above, self.path.name)
            self._aside = Path(self._staging.name, "out")
            self._aside.mkdir()
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Move the files into OUT, or forget them where an exception passes."""
        assert self._staging is not None
        try:
            if kind is None:
                self._publish(self._aside)
        except OSError as problem:
            raise OutputError(f"{self.path}: cannot be written: {problem.strerror or problem}") from None
        finally:
            self._staging.cleanup()

    def file(self, name: str) -> Path:
        """Return path to write the file `name` of OUT to, within the context."""
        if Path(name).name != name or name in ("", ".."):
            raise ArgumentError("name", "the name of a file, without a folder", name)
        return self._aside / name

    def write_json(self, name: str, document: Mapping[str, Any]) -> None:
        """Write a JSON file; ``schema`` names its type. NaN and infinity have no place in JSON.

        Raises ArgumentError where there is no schema or a value cannot be written.
        """
        if not document.get("schema"):
            raise ArgumentError("document", "a key 'schema' that names its form and version", sorted(document))
        try:
            text = json.dumps(document, indent=2, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise ArgumentError("document", "JSON values", error) from None
        self.file(name).write_text(text + "\n", encoding="utf-8")

    def _publish(self, aside: Path) -> None:
        staged = [file.name for file in aside.iterdir()]
        sync(*aside.iterdir(), aside)
        if not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            os.replace(aside, self.path)
            sync(self.path.parent)
            return
        self._require_no_folders(staged)
        if _LAST in staged:
            (self.path / _LAST).unlink(missing_ok=True)
        for name in sorted(staged, key=_LAST.__eq__):
            os.replace(aside / name, self.path / name)
        sync(self.path)

    def _require_no_folders(self, names: Sequence[str]) -> None:
        for name in names:
            if (self.path / name).is_dir():
                raise OutputError(f"{self.path / name}: expected a file or nothing, got a folder")
