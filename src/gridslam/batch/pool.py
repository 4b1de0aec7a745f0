"""The executor of this machine: a thread for each worker, which has one child at a time."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, final

from gridslam.batch.child import run_job
from gridslam.errors import ArgumentError

__all__ = ["ProcessPool"]

_MOST_WORKERS = 256


@final
class ProcessPool:
    """Runs jobs in child processes of this machine; an `Executor`.

    Parameters
    ----------
    workers : int, [1, 256]
        Number of children at a time.
    """

    def __init__(self, workers: int) -> None:
        """Start nothing yet."""
        if not 1 <= workers <= _MOST_WORKERS:
            raise ArgumentError("workers", f"a number from 1 to {_MOST_WORKERS}", workers)
        self._workers = workers
        self._threads: ThreadPoolExecutor | None = None

    def __enter__(self) -> ProcessPool:
        """Start the threads that wait for the children."""
        self._threads = ThreadPoolExecutor(self._workers, thread_name_prefix="batch")
        return self

    def __exit__(self, *error: object) -> None:
        """Wait for the children that still run: `run_jobs` has ended their batch, so that they are killed."""
        assert self._threads is not None
        self._threads.shutdown(cancel_futures=True)

    def capacity(self) -> int:
        """Return the number of jobs at a time; the one beyond the workers is there when the first of them ends."""
        return self._workers + 1

    def submit(self, job: dict[str, Any], limits: dict[str, Any]) -> Future[dict[str, Any]]:
        """Run a job in the next idle thread."""
        assert self._threads is not None
        return self._threads.submit(run_job, job, limits)
