"""The executor of this machine: as many fork servers as workers, each with one child at a time."""

from __future__ import annotations

import queue
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, final

from gridslam.batch.child import ForkServer
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
        self._servers = list[ForkServer]()
        self._idle = queue.SimpleQueue[ForkServer]()
        self._threads: ThreadPoolExecutor | None = None

    def __enter__(self) -> ProcessPool:
        """Start the threads that wait for the servers, which start with their first jobs."""
        self._servers = [ForkServer() for _ in range(self._workers)]
        self._idle = queue.SimpleQueue[ForkServer]()
        for server in self._servers:
            self._idle.put(server)
        self._threads = ThreadPoolExecutor(self._workers, thread_name_prefix="batch")
        return self

    def __exit__(self, *error: object) -> None:
        """Kill the children that still run, and end the servers."""
        assert self._threads is not None
        self._threads.shutdown(wait=False, cancel_futures=True)
        for server in self._servers:
            server.close()
        self._threads.shutdown()

    def capacity(self) -> int:
        """Return the number of jobs at a time; the one beyond the workers is there when the first of them ends."""
        return self._workers + 1

    def submit(self, job: dict[str, Any], limits: dict[str, Any]) -> Future[dict[str, Any]]:
        """Run a job on the next idle server."""
        assert self._threads is not None
        return self._threads.submit(self._run, job, limits)

    def _run(self, job: dict[str, Any], limits: dict[str, Any]) -> dict[str, Any]:
        server = self._idle.get()
        try:
            return server.run(job, limits)
        finally:
            self._idle.put(server)
