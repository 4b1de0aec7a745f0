"""Results are written to a temporary folder and then renamed, so that a run leaves all of its files or none."""

from __future__ import annotations

import bz2
import gzip
import json
import os
import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast, final

from gridslam.errors import ArgumentError, OutputError

__all__ = ["OutputFolder", "open_for_writing", "write_atomically"]


@contextmanager
def write_atomically(path: str | Path) -> Iterator[Path]:
    """Give a path beside `path` to write to; it becomes `path` at the end or, after an exception, is removed."""
    target = Path(path)
    aside = target.with_name(f".{target.name}.{secrets.token_hex(4)}.partial")
    try:
        yield aside
        os.replace(aside, target)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
    finally:
        aside.unlink(missing_ok=True)


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
    """The folder OUT of a run; use it as a context manager and write to what `file` gives.

    When the context is left without an exception the files move into OUT, replacing those of the same names; other
    files in OUT stay. When an exception passes (an interrupt too), OUT is as it was before.

    Parameters
    ----------
    path : str or Path
        OUT; it and the folders above it are made where there are none.

    Raises
    ------
    OutputError
        On entering, where OUT is a file or cannot be written; on leaving, where a file cannot be moved into it.
    """

    def __init__(self, path: str | Path) -> None:
        """Name the folder; nothing is touched before the context is entered."""
        self.path = Path(path)
        self._aside = Path()

    def __enter__(self) -> OutputFolder:
        """Check that OUT can be written and create the temporary folder."""
        above = self.path
        while not above.exists() and above != above.parent:
            above = above.parent
        if not above.is_dir():
            raise OutputError(f"{self.path}: expected a folder to write to, but {above} is a file")
        # Within OUT where there is one: it may be a file system of its own, to which nothing can be renamed.
        self._aside = above / f".{self.path.name}.{secrets.token_hex(4)}.partial"
        try:
            self._aside.mkdir()
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Move the files into OUT, or forget them where an exception passes."""
        try:
            if kind is None:
                self._publish()
        except OSError as problem:
            raise OutputError(f"{self.path}: cannot be written: {problem.strerror or problem}") from None
        finally:
            shutil.rmtree(self._aside, ignore_errors=True)

    def file(self, name: str) -> Path:
        """Path to write the file `name` of OUT to, within the context."""
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

    def _publish(self) -> None:
        if not self.path.exists():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            os.replace(self._aside, self.path)
            return
        staged = [file.name for file in self._aside.iterdir()]
        for name in staged:
            if (self.path / name).is_dir():
                raise OutputError(f"{self.path / name}: expected a file or nothing, got a folder")
        replaced = self._aside / ".replaced"
        replaced.mkdir()
        try:
            for name in staged:
                if (self.path / name).exists():
                    os.replace(self.path / name, replaced / name)
                os.replace(self._aside / name, self.path / name)
        except BaseException:
            self._restore(staged, replaced)
            raise

    def _restore(self, staged: list[str], replaced: Path) -> None:
        """Undo the moves; the location of the files shows which of them had happened."""
        for name in staged:
            if (replaced / name).exists():
                os.replace(replaced / name, self.path / name)
            elif not (self._aside / name).exists():
                (self.path / name).unlink()
