"""Publish a finished batch: its page, its table, and copies of all results at a URL.

The results of a job are uploaded by its child, so that as many connections as workers carry them; the page, the table
and the journal by the batch itself.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, final

from gridslam.batch.job import Job
from gridslam.batch.journal import JOURNAL
from gridslam.batch.report import write_report
from gridslam.batch.runs import DONE, write_parquet
from gridslam.errors import InputError, MissingDependencyError, OutputError
from gridslam.io.output import OutputFolder
from gridslam.io.remote import connect, describe_remote, is_url, mask_url, upload_file, upload_folder

__all__ = ["Publisher", "run_and_upload"]

_UPLOADS: Final = 32
"""Files and folders that are uploaded at a time: a request waits some 50 ms for its answer."""


@final
class Publisher:
    """Writes the page and the table of a batch, and uploads the results.

    Parameters
    ----------
    out : Path
        OUT, the folder of the batch.
    url : str, optional
        Where its results are copied to: the folder of a job by its child (see `wrap`), the rest by `parts`.
    parquet : bool
        Whether `parts` has runs.parquet.

    Raises
    ------
    InputError
        `url` is no URL.
    MissingDependencyError
        The library for it, or for the table, is not installed.
    """

    def __init__(self, out: Path, url: str | None = None, *, parquet: bool = False) -> None:
        """Check that the required libraries are installed; nothing is read or written yet."""
        if parquet and importlib.util.find_spec("pyarrow") is None:
            raise MissingDependencyError("runs.parquet", "pyarrow", "parquet")
        self._out = out
        self._url = None if url is None else url.rstrip("/")
        self._parquet = parquet
        self._done: list[str] = []
        self._uploads: list[Future[None]] = []
        self._threads: ThreadPoolExecutor | None = None
        if self._url is not None:
            if not is_url(self._url):
                raise InputError(self._url, "expected a URL, such as s3://bucket/folder")
            connect(self._url)
            self._threads = ThreadPoolExecutor(_UPLOADS, thread_name_prefix="upload")

    def wrap(self, job: Job) -> Job:
        """Let a job upload its results when it has them, if they are wanted elsewhere."""
        if self._url is None:
            return job
        arguments = job.arguments | {"target": job.target, "upload": self._url}
        return replace(job, target=f"{__name__}:{run_and_upload.__name__}", arguments=arguments)

    def on_row(self, row: Mapping[str, Any]) -> None:
        """Upload the results of a job that was done before, unless they are there."""
        if self._threads is not None and row["status"] == DONE:
            self._done.append(row["folder"])
            if row.get("resumed"):
                self._uploads.append(self._threads.submit(self._upload_missing, row["folder"]))

    def parts(self) -> Iterator[Callable[[], str]]:
        """Yield functions that write the page and the table or upload, each of which returns a line of the summary.

        Each raises OutputError where something cannot be written or uploaded; the other parts can be.
        """
        yield lambda: f"report: {write_report(self._out)}"
        if self._parquet:
            yield lambda: f"table: {write_parquet(self._out)}"
        if self._url is not None:
            yield self._finish_uploads

    def _finish_uploads(self) -> str:
        assert self._threads is not None
        assert self._url is not None
        files = [path for path in self._out.iterdir() if path.name.startswith(("report.", "runs.")) and path.is_file()]
        files += [path for folder in self._done for path in (self._out / folder).glob("thumbnail.jpg")]
        self._uploads += [
            self._threads.submit(upload_file, path, f"{self._url}/{path.relative_to(self._out).as_posix()}")
            for path in files
            if path.name not in (f"{JOURNAL}-wal", f"{JOURNAL}-shm")
        ]
        failed = [error for future in self._uploads if (error := future.exception()) is not None]
        self._threads.shutdown()
        if failed:
            raise OutputError(
                f"{len(failed)} uploads failed, the same command tries them again; the first: {failed[0]}"
            )
        return f"uploaded to {mask_url(self._url)}"

    def _upload_missing(self, folder: str) -> None:
        try:
            describe_remote(f"{self._url}/{folder}/run.json")
        except InputError:
            upload_folder(self._out / folder, f"{self._url}/{folder}")


def run_and_upload(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Call the function ``target`` of a job, and copy its folder below the URL ``upload``, run.json as the last."""
    module, _, name = arguments["target"].partition(":")
    out = Path(arguments["out"])
    document: dict[str, Any] = getattr(importlib.import_module(module), name)(arguments)
    if not (out / "run.json").is_file():  # otherwise it would be written after the upload
        document = document | {"job": arguments["job"]}
        with OutputFolder(out) as folder:
            folder.write_json("run.json", document)
    upload_folder(out, f"{arguments['upload']}/{out.name}")
    return document
