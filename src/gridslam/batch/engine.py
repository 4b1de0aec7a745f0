"""Run many jobs (`run_jobs`), each with exactly one row in the journal; finished jobs are skipped."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, Final

from gridslam.batch.child import remove_partial, run_job, start_row
from gridslam.batch.job import Job
from gridslam.batch.journal import Journal
from gridslam.errors import ArgumentError, InputError, OutputError
from gridslam.io.remote import is_url
from gridslam.io.text import read_json

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

_POLL_S = 0.5
MOST_WORKERS: Final = 256
_ENDING_S = 5.0
_OF_THE_LOG: Final = frozenset({"InputError", "ArgumentError", "ConfigurationError"})
"""Errors that the same key always has, unless a server, the machine or its limits had to do with them."""
_OF_THE_MACHINE: Final = ("--max-memory", *map(os.strerror, errno.errorcode))
_FULL: Final = tuple(os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT))


def run_jobs(
    jobs: Sequence[Job],
    out: str | Path,
    *,
    workers: int,
    timeout_s: float | None = None,
    on_row: Callable[[dict[str, Any]], None] = lambda row: None,
    on_poll: Callable[[], object] = lambda: None,
) -> list[dict[str, Any]]:
    """Run jobs, at most once each, and write a row of the journal OUT/runs.sqlite for each.

    A job is done when run.json in its folder has its key. Such jobs are not run again, nor those that failed for their
    log's own sake (InputError of a file that could be read); those that failed for another reason are. A row is written
    when its job has ended, so a batch that is killed at any time continues where it was.

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
    on_poll : callable
        Called at least twice a second.

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
        _clean(folder)

        def record(row: dict[str, Any], *, resumed: bool) -> None:
            rows[row["folder"]] = row | {"resumed": resumed}
            on_row(rows[row["folder"]])

        queue = deque[Job]()
        for job in jobs:
            earlier = _find_earlier(job, folder, journal)
            if earlier is None:
                queue.append(job)
            else:
                record(earlier, resumed=True)
            on_poll()
        run = partial(run_job, out=folder.absolute(), timeout_s=timeout_s)
        try:
            with closing(_run(queue, run, workers, on_poll)) as ended:
                for together in ended:
                    full = next((row for row in together if _is_disk_full(row)), None)
                    kept = [row for row in together if not _is_disk_full(row)]
                    with journal.transaction():
                        for row in kept:
                            journal.write(row)
                    for row in kept:
                        record(row, resumed=False)
                    if full is not None:
                        problem = f"{full['message']}; run the same command again when there is space"
                        raise OutputError(f"{out}: {problem}")
        finally:
            _clean(folder)
    return [rows[job.folder] for job in jobs]


def _run(
    queue: deque[Job], run: Callable[..., dict[str, Any]], workers: int, on_poll: Callable[[], object]
) -> Generator[list[dict[str, Any]], None, None]:
    """Yield the rows of jobs as they end, those together that have ended since the last time."""
    pending = set[Future[dict[str, Any]]]()
    stopped = threading.Event()
    threads = ThreadPoolExecutor(workers, thread_name_prefix="batch")
    try:
        while queue or pending:
            while queue and len(pending) <= workers:  # one more than run, so that no thread waits for the next
                pending.add(threads.submit(run, queue.popleft(), stopped=stopped))
            ended, pending = wait(pending, _POLL_S, FIRST_COMPLETED)
            try:
                rows = [future.result() for future in ended]
            except (EOFError, OSError) as error:
                raise OutputError(f"a job cannot be run: {error}") from None
            on_poll()
            if rows:
                yield rows
    finally:
        stopped.set()
        threads.shutdown(cancel_futures=True)


def _find_earlier(job: Job, out: Path, journal: Journal) -> dict[str, Any] | None:
    """Row of a job that needs not be run, from the journal; or from run.json, where the journal was not written."""
    row = journal.find(job.folder)
    same = row is not None and row["key"] == job.key
    document = _read_done(out / job.folder / "run.json", job.key)
    if document is not None:
        if row is not None and same and row["status"] == "done":
            return row
        restored = start_row(job) | {"status": "done", "document": document}
        restored |= _read_costs(document)
        journal.write(restored)
        return restored
    return row if row is not None and same and _fails_again(row) else None


def _fails_again(row: Mapping[str, Any]) -> bool:
    """Return whether a job has failed for its log's own sake, and not since something could not be reached or read."""
    is_of_machine = any(text in (row["message"] or "") for text in _OF_THE_MACHINE)
    return row["error"] in _OF_THE_LOG and not is_url(row["log"]) and not is_of_machine


def _read_costs(document: dict[str, Any]) -> dict[str, Any]:
    """Read the costs of a job from its run.json."""
    time_ = document.get("time")
    times = time_ if isinstance(time_, dict) else {}
    return {
        "wall_s": times.get("wall_s"),
        "cpu_s": times.get("cpu_s"),
        "peak_memory_bytes": document.get("peak_memory_bytes"),
    }


def _read_done(path: Path, key: str) -> dict[str, Any] | None:
    """Return content of run.json, if it is the result of the job with this key."""
    if not path.is_file():
        return None
    try:
        document = read_json(path)
    except InputError:
        return None
    job = document.get("job")
    return document if isinstance(job, dict) and job.get("key") == key else None


def _is_disk_full(row: Mapping[str, Any]) -> bool:
    """Return whether a job has failed since the disk is full: the others would, too."""
    message = row["message"] or ""
    return row["error"] in ("OutputError", "OSError") and any(text in message for text in _FULL)


def _check(jobs: Sequence[Job], workers: int, timeout_s: float | None) -> None:
    twice = [name for name, count in Counter(job.folder for job in jobs).items() if count > 1]
    if twice:
        raise ArgumentError("jobs", "a folder for each", f"{twice[0]} twice")
    if timeout_s is not None and not 0 < timeout_s < float("inf"):
        raise ArgumentError("timeout_s", "a time > 0 s", timeout_s)
    if not 1 <= workers <= MOST_WORKERS:
        raise ArgumentError("workers", f"a number from 1 to {MOST_WORKERS}", workers)


def _clean(out: Path) -> None:
    """Remove files that killed processes left in OUT; no other process uses OUT but those that are about to end."""
    end = time.monotonic() + _ENDING_S
    with suppress(OSError):
        while left := list(out.glob(".*.partial")):
            for path in left:
                remove_partial(out / path.name[1:].rsplit(".", 2)[0])
            if time.monotonic() > end:
                break
            time.sleep(0.02)


@contextmanager
def _lock(out: Path) -> Iterator[None]:
    """Lock OUT for this process, as far as its file system has locks."""
    if fcntl is None:
        yield
        return
    descriptor = os.open(out, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(f"{out}: another batch is running in this folder") from None
        except OSError:
            pass
        yield
    finally:
        os.close(descriptor)
