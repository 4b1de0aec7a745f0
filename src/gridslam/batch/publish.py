"""What follows the jobs of a batch: its page, its table, and copies of all results at a URL."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, final

from gridslam.batch.journal import JOURNAL
from gridslam.batch.report import write_report
from gridslam.batch.runs import DONE, write_parquet
from gridslam.errors import InputError, OutputError
from gridslam.io.remote import connect, describe_remote, is_url, mask_url, upload_file, upload_folder

__all__ = ["Publisher"]

_UPLOADS: Final = 8
"""Folders that are uploaded at a time: a request waits some 50 ms for its answer."""


@final
class Publisher:
    """Writes the page and the table of a batch, and uploads what is wanted elsewhere.

    Parameters
    ----------
    out : Path
        OUT, the folder of the batch.
    url : str, optional
        Where its results are copied to: the folder of a job when it has ended, the rest by `finish`.
    parquet : bool
        Whether `finish` writes runs.parquet.

    Raises
    ------
    InputError
        `url` is no URL.
    MissingDependencyError
        The library for it is not installed.
    """

    def __init__(self, out: Path, url: str | None = None, *, parquet: bool = False) -> None:
        """Check that there is a library for the URL; nothing is read or written yet."""
        self._out = out
        self._url = None if url is None else url.rstrip("/")
        self._parquet = parquet
        self._uploads: dict[str, Future[None]] = {}
        self._threads: ThreadPoolExecutor | None = None
        if self._url is not None:
            if not is_url(self._url):
                raise InputError(self._url, "expected a URL, such as s3://bucket/folder")
            connect(self._url)
            self._threads = ThreadPoolExecutor(_UPLOADS, thread_name_prefix="upload")

    def on_row(self, row: Mapping[str, Any]) -> None:
        """Begin to upload the results of a job that is done; those of an earlier batch unless they are there."""
        if self._threads is not None and row["status"] == DONE:
            upload = self._upload_missing if row.get("resumed") else self._upload
            self._uploads[row["folder"]] = self._threads.submit(upload, row["folder"])

    def finish(self) -> list[str]:
        """Write the page and the table, wait for the uploads, and return lines for the summary.

        Raises
        ------
        OutputError
            Something cannot be written or uploaded; the others are.
        """
        lines = [f"report: {write_report(self._out)}"]
        if self._parquet:
            lines.append(f"table: {write_parquet(self._out)}")
        if self._threads is None or self._url is None:
            return lines
        failed = {
            folder: error for folder, future in self._uploads.items() if (error := future.exception()) is not None
        }
        files = [path for path in self._out.iterdir() if path.name.startswith(("report.", "runs.")) and path.is_file()]
        files += [path for folder in self._uploads for path in (self._out / folder).glob("thumbnail.jpg")]
        rest = [
            self._threads.submit(upload_file, path, f"{self._url}/{path.relative_to(self._out).as_posix()}")
            for path in files
            if path.name not in (f"{JOURNAL}-wal", f"{JOURNAL}-shm")
        ]
        failed |= {f"file {k}": error for k, future in enumerate(rest) if (error := future.exception()) is not None}
        self._threads.shutdown()
        if failed:
            first = next(iter(failed.values()))
            raise OutputError(f"{len(failed)} uploads failed, the same command tries them again; the first: {first}")
        return [*lines, f"uploaded to {mask_url(self._url)}"]

    def _upload(self, folder: str) -> None:
        upload_folder(self._out / folder, f"{self._url}/{folder}")

    def _upload_missing(self, folder: str) -> None:
        try:
            describe_remote(f"{self._url}/{folder}/run.json")
        except InputError:
            self._upload(folder)
