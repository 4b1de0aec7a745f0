"""Run many jobs (`run_jobs`), each with exactly one row in the journal; finished jobs are skipped."""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from gridslam.batch.child import run_job
from gridslam.batch.job import Job
from gridslam.batch.journal import Journal, read_rows
from gridslam.errors import ArgumentError, OutputError
from gridslam.io.output import remove_abandoned

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

MOST_WORKERS: Final = 256


def run_jobs(
    jobs: Sequence[Job],
    out: str | Path,
    *,
    workers: int,
    timeout_s: float | None = None,
    on_row: Callable[[dict[str, Any]], None] = lambda row: None,
) -> list[dict[str, Any]]:
    """Run jobs, at most once each, and write a row of the journal OUT/runs.sqlite for each.

    A job is done when the journal has a row of its key that is done, and its folder is there. Such jobs are not run
    again; those that failed are. A row is written when its job has ended, so a batch that is killed at any time
    continues where it was.

    Parameters
    ----------
    jobs : sequence of Job
        Begun in this order.
    out : str or Path
        OUT; created if missing. One batch at a time may run in it.
    workers : int
        How many run at a time, 1 to 256.
    timeout_s : float, optional
        Time limit of each job, s.
    on_row : callable
        Called with each row when its job has ended, first with those of earlier runs, whose ``resumed`` is true.

    Returns
    -------
    list of dict
        The rows, in the order of `jobs`; ``document`` is an object or None.

    Raises
    ------
    ArgumentError
        Two jobs have the same folder, or a limit is out of range.
    OutputError
        OUT cannot be written (the disk is full), or another batch runs in it. Rows that were written stay.
    """
    _check(jobs, workers, timeout_s)
    folder = Path(out)
    rows = dict[str, dict[str, Any]]()
    with Journal(folder) as journal, _lock(folder):
        remove_abandoned(folder)

        def record(row: dict[str, Any], *, resumed: bool) -> None:
            rows[row["folder"]] = row | {"resumed": resumed}
            on_row(rows[row["folder"]])

        before = {row["folder"]: row for row in read_rows(folder)}
        left = []
        for job in jobs:
            row = before.get(job.folder, {})
            if row.get("key") == job.key and row["status"] == "done" and (folder / job.folder).is_dir():
                record(row, resumed=True)
            else:
                left.append(job)
        with closing(_run(left, folder.absolute(), workers, timeout_s)) as ended:
            for row in ended:
                journal.write(row)
                record(row, resumed=False)
    return [rows[job.folder] for job in jobs]


def _run(
    jobs: Sequence[Job], out: Path, workers: int, timeout_s: float | None
) -> Generator[dict[str, Any], None, None]:
    """Yield the rows of jobs as they end."""
    stopped = threading.Event()
    threads = ThreadPoolExecutor(workers, thread_name_prefix="batch")
    try:
        for future in as_completed([threads.submit(run_job, job, out, stopped, timeout_s=timeout_s) for job in jobs]):
            yield future.result()
    finally:
        stopped.set()
        threads.shutdown(cancel_futures=True)


def _check(jobs: Sequence[Job], workers: int, timeout_s: float | None) -> None:
    twice = [name for name, count in Counter(job.folder for job in jobs).items() if count > 1]
    if twice:
        raise ArgumentError("jobs", "a folder for each", f"{twice[0]} twice")
    if timeout_s is not None and not 0 < timeout_s < float("inf"):
        raise ArgumentError("timeout_s", "a time > 0 s", timeout_s)
    if not 1 <= workers <= MOST_WORKERS:
        raise ArgumentError("workers", f"a number from 1 to {MOST_WORKERS}", workers)


@contextmanager
def _lock(out: Path) -> Iterator[None]:
    """Lock OUT for this process, as far as its file system has locks."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(out, os.O_RDONLY | os.O_CLOEXEC)
    try:
        with suppress(OSError):
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise OutputError(f"{out}: another batch is running in this folder") from None
        yield
    finally:
        os.close(descriptor)
