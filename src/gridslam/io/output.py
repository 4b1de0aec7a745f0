"""Results are written to a temporary folder and then renamed, so that a run leaves all of its files or none."""

from __future__ import annotations

import bz2
import gzip
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast, final

from gridslam.errors import ArgumentError, OutputError
from gridslam.io.staging import REPLACED, StagingFolder, exchange_folders, remove_abandoned, sync


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
        with tempfile.TemporaryDirectory(".partial", f".{path.name}.", above, ignore_cleanup_errors=True) as folder:
            Path(folder, path.relative_to(above)).mkdir(parents=True, exist_ok=True)  # whether there can be such names
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None


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
    staging: StagingFolder | None = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        staging = StagingFolder(target.parent, target.name)
        aside = staging.path / target.name
        yield aside
        sync(*aside.rglob("*"), aside)
        os.replace(aside, target)
        sync(target.parent)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        if staging is not None:
            staging.remove()


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
    files in OUT stay. When an exception passes (an interrupt too), OUT is as it was before. A process that is killed
    leaves the files of before or those of after: a new folder is renamed, and one that holds an earlier result is
    exchanged as a whole, where the system can (Linux) and it has no folders in it. Otherwise the files move one by one,
    and the next run completes what was interrupted.

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
        self._staging: StagingFolder | None = None

    def __enter__(self) -> OutputFolder:
        """Check that OUT can be written and create the temporary folder."""
        above = _find_folder(self.path, self.path)
        try:
            self._require_no_folders(self._names)
            if above == self.path and not os.access(above, os.W_OK | os.X_OK):
                raise OutputError(f"{self.path}: cannot be written: Permission denied")
            self._staging = self._stage(above)
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
                self._publish(self._staging.path)
        except OSError as problem:
            raise OutputError(f"{self.path}: cannot be written: {problem.strerror or problem}") from None
        finally:
            self._staging.remove()

    def file(self, name: str) -> Path:
        """Return path to write the file `name` of OUT to, within the context."""
        if Path(name).name != name or name in ("", ".."):
            raise ArgumentError("name", "the name of a file, without a folder", name)
        assert self._staging is not None
        return self._staging.path / name

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

    def _stage(self, above: Path) -> StagingFolder:
        """Create the temporary folder: beside OUT if that can be exchanged, otherwise in it or in the folder above."""
        name = self.path.name
        if above != self.path:
            return StagingFolder(above, name)
        out = self.path.resolve()
        if any(file.name.endswith(".partial") for file in out.iterdir()):
            StagingFolder(self.path, name, self.path).remove()  # it completes what was interrupted
            remove_abandoned(out)
        if self._is_exchangeable(out.parent):
            with suppress(OSError):
                return StagingFolder(out.parent, out.name, out)
        return StagingFolder(self.path, name, self.path)

    def _is_exchangeable(self, beside: Path) -> bool:
        """Whether OUT contains only an earlier result, and is not this process's working folder.

        A mount point cannot be exchanged.
        """
        here = Path.cwd()
        return (
            (self.path / "run.json").is_file()
            and all(
                file.is_file() and not file.is_symlink()
                for file in self.path.iterdir()
                if not file.name.endswith(".partial")
            )
            and not any(folder.samefile(self.path) for folder in (here, *here.parents))
            and beside.stat().st_dev == self.path.stat().st_dev
            and os.access(beside, os.W_OK | os.X_OK)
        )

    def _publish(self, aside: Path) -> None:
        staged = [file.name for file in aside.iterdir()]
        sync(*aside.iterdir(), aside)
        if not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            os.replace(aside, self.path)
            sync(self.path.parent)
            return
        self._require_no_folders(staged)
        if aside.parent == self.path or not self._exchange(aside):
            self._move(aside, staged)
        sync(self.path)

    def _exchange(self, aside: Path) -> bool:
        """Exchange the folder with OUT; OUT's other files are in both. Return False if that is impossible."""
        out = self.path.resolve()
        if not self._is_exchangeable(aside.parent):
            return False
        linked = []
        try:
            for file in out.iterdir():
                if not (aside / file.name).exists():
                    os.link(file, aside / file.name)
                    linked.append(aside / file.name)
            shutil.copystat(out, aside)
            is_exchanged = exchange_folders(aside, out)
        except OSError:  # a file system without links
            is_exchanged = False
        if not is_exchanged:
            for link in linked:
                link.unlink()
            return False
        for file in aside.iterdir():
            if not os.path.lexists(out / file.name):  # it was created just now
                os.replace(file, out / file.name)
        sync(aside.parent)
        return True

    def _move(self, aside: Path, staged: Sequence[str]) -> None:
        """Move the files one by one, run.json as the last: who finds it finds all."""
        replaced = aside / REPLACED
        replaced.mkdir()
        try:
            for name in sorted(staged, key="run.json".__eq__):
                if os.path.lexists(self.path / name):
                    os.replace(self.path / name, replaced / name)
                os.replace(aside / name, self.path / name)
        except BaseException:
            self._restore(aside, staged, replaced)
            raise

    def _restore(self, aside: Path, staged: Sequence[str], replaced: Path) -> None:
        """Undo the moves; the location of the files shows which of them had happened."""
        for name in staged:
            if os.path.lexists(replaced / name):
                os.replace(replaced / name, self.path / name)
            elif not (aside / name).exists():
                (self.path / name).unlink()

    def _require_no_folders(self, names: Sequence[str]) -> None:
        for name in names:
            if (self.path / name).is_dir():
                raise OutputError(f"{self.path / name}: expected a file or nothing, got a folder")
