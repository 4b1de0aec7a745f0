"""Run many jobs by an executor (`run_jobs`), each with exactly one row in the journal; finished jobs are skipped."""

from __future__ import annotations

import errno
import os
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Final, Protocol

from gridslam import __version__
from gridslam.batch.child import LostWorkerError, attempts_folder, lost_row, remove_partial
from gridslam.batch.job import Job
from gridslam.batch.journal import Journal
from gridslam.errors import ArgumentError, InputError, OutputError
from gridslam.io.text import read_json

try:
    import fcntl
except ImportError:  # Windows has no such locks
    fcntl = None  # type: ignore[assignment]

__all__ = ["Executor", "run_jobs"]

_POLL_S = 0.5
_MOST_ROWS = 1000  # of a transaction of the journal
_ENDING_S = 5.0
_MOST_LOST: Final = 10
"""Times that a job may be lost before a worker has begun it."""
_OF_THE_LOG: Final = frozenset({"InputError", "ArgumentError", "ConfigurationError"})
"""Errors that the same key always has; all others may have had to do with the machine, and are tried again."""
_FULL: Final = tuple(os.strerror(number) for number in (errno.ENOSPC, errno.EDQUOT))


class Executor(Protocol):
    """Runs jobs; a context manager that ends running jobs on exit."""

    def capacity(self) -> int:
        """Return how many jobs are to be handed over at a time: enough that no worker waits."""
        ...

    def submit(self, job: dict[str, Any], limits: dict[str, Any]) -> Future[dict[str, Any]]:
        """Call `run_job` with these somewhere; the future raises LostWorkerError where the worker was lost."""
        ...

    def __enter__(self) -> Executor:
        """Return the executor itself."""
        ...

    def __exit__(self, *error: object) -> None:
        """End the workers and their jobs."""
        ...


def run_jobs(
    jobs: Sequence[Job],
    out: str | Path,
    *,
    executor: Executor,
    timeout_s: float | None = None,
    memory_bytes: int | None = None,
    retries: int = 1,
    on_row: Callable[[dict[str, Any]], None] = lambda row: None,
    on_poll: Callable[[], None] = lambda: None,
) -> list[dict[str, Any]]:
    """Run jobs, at most once each, and write a row of the journal OUT/runs.sqlite for each.

    A job is done when run.json in its folder has its key. Such jobs are not run again, nor those that failed for their
    log's own sake (InputError); those that failed for another reason are. A row is written when its job has ended, so a
    batch that is killed at any time continues where it was.

    Parameters
    ----------
    jobs : sequence of Job
        Begun in this order.
    out : str or Path
        OUT; created if missing. One batch at a time may run in it.
    executor : Executor
        Where they run; its context is entered and left here.
    timeout_s : float, optional
        Time limit of each job, s.
    memory_bytes : int, optional
        Limit of the address space of each job (Linux).
    retries : int, >= 0
        A job whose worker is lost is run again elsewhere, at most this many times.
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
    _check(jobs, timeout_s, memory_bytes, retries)
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
        limits = {
            "out": os.fspath(folder.absolute()),
            "timeout_s": timeout_s,
            "memory_bytes": memory_bytes,
            "attempts": retries + 1,
            "version": __version__,
        }
        try:
            with closing(_run(queue, limits, executor, on_poll)) as ended:
                for together in ended:
                    full = next((row for row in together if _is_disk_full(row)), None)
                    kept = [row for row in together if not _is_disk_full(row)]
                    with journal.transaction():
                        for row in kept:
                            journal.write(row)
                    for row in kept:
                        (attempts_folder(folder) / row["folder"]).unlink(missing_ok=True)
                        record(row, resumed=False)
                    if full is not None:
                        problem = f"{full['message']}; run the same command again when there is space"
                        raise OutputError(f"{out}: {problem}")
        finally:
            _clean(folder)
    return [rows[job.folder] for job in jobs]


def _run(
    queue: deque[Job], limits: dict[str, Any], executor: Executor, on_poll: Callable[[], None]
) -> Generator[list[dict[str, Any]], None, None]:
    """Yield the rows of jobs as they end, those together that have ended since the last time."""
    lost = Counter[str]()
    pending = dict[Future[dict[str, Any]], Job]()
    ended = SimpleQueue[Future[dict[str, Any]]]()  # asking all that are pending would take longer, the more there are
    with executor, _attempts(limits["out"]):
        while queue or pending:
            while queue and len(pending) < executor.capacity():
                job = queue.popleft()
                future = executor.submit(job.to_dict(), limits)
                pending[future] = job
                future.add_done_callback(ended.put)
            rows = []
            for future in _take(ended):
                job = pending.pop(future)
                try:
                    row = future.result()
                except LostWorkerError:
                    lost[job.folder] += 1
                    begun = _count_attempts(limits["out"], job.folder)
                    if begun < limits["attempts"] and lost[job.folder] < limits["attempts"] + _MOST_LOST:
                        queue.appendleft(job)
                        continue
                    row = lost_row(job.to_dict(), begun)
                except OSError as error:
                    raise OutputError(f"{limits['out']}: {job.folder} cannot be run: {error}") from None
                rows.append(row)
            on_poll()
            if rows:
                yield rows


def _take(ended: SimpleQueue[Future[dict[str, Any]]]) -> list[Future[dict[str, Any]]]:
    """Wait for a moment until a job has ended; return all that have, up to a number."""
    taken = []
    with suppress(Empty):
        taken.append(ended.get(timeout=_POLL_S))
        while len(taken) < _MOST_ROWS:
            taken.append(ended.get_nowait())
    return taken


@contextmanager
def _attempts(out: str) -> Iterator[None]:
    """Have the folder in which jobs are claimed; where it is gone, workers end their children."""
    folder = attempts_folder(out)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error.strerror}") from None
    try:
        yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _count_attempts(out: str, folder: str) -> int:
    """Return how often workers have begun the job of a folder."""
    try:
        return (attempts_folder(out) / folder).stat().st_size
    except OSError:
        return 0


def _find_earlier(job: Job, out: Path, journal: Journal) -> dict[str, Any] | None:
    """Row of a job that needs not be run, from the journal; or from run.json, where the journal was not written."""
    row = journal.find(job.folder)
    same = row is not None and row["key"] == job.key
    document = _read_done(out / job.folder / "run.json", job.key)
    if document is not None:
        if row is not None and same and row["status"] == "done":
            return row
        restored = lost_row(job.to_dict(), 1) | {"status": "done", "error": None, "message": None, "document": document}
        restored |= _read_costs(document)
        journal.write(restored)
        return restored
    if row is not None and same and row["error"] in _OF_THE_LOG and "--max-memory" not in (row["message"] or ""):
        return row
    return None


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


def _check(jobs: Sequence[Job], timeout_s: float | None, memory_bytes: int | None, retries: int) -> None:
    twice = [name for name, count in Counter(job.folder for job in jobs).items() if count > 1]
    if twice:
        raise ArgumentError("jobs", "a folder for each", f"{twice[0]} twice")
    if timeout_s is not None and not 0 < timeout_s < float("inf"):
        raise ArgumentError("timeout_s", "a time > 0 s", timeout_s)
    if memory_bytes is not None and memory_bytes < 1:
        raise ArgumentError("memory_bytes", "a number >= 1", memory_bytes)
    if retries < 0:
        raise ArgumentError("retries", "a number >= 0", retries)


def _clean(out: Path) -> None:
    """Remove files that killed processes left in OUT; no other process uses OUT but those that are about to end."""
    shutil.rmtree(attempts_folder(out), ignore_errors=True)  # where it is gone, workers end their children
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
