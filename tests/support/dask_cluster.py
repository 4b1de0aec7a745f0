"""A Dask scheduler and workers as processes of this machine, each of which can be killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from gridslam.errors import InputError
from gridslam.io.text import read_json

SETTINGS = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s", "DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": "False"}


class DaskCluster:
    """Starts a scheduler and workers with one thread each; a context manager that ends them."""

    def __init__(self, folder: Path, workers: int, *, nannies: bool = False) -> None:
        self.file = folder / "scheduler.json"
        self._folder = folder
        self._nanny = "--nanny" if nannies else "--no-nanny"
        self._log = (folder / "dask.txt").open("w")
        where = "--host", "127.0.0.1", "--scheduler-file", self.file
        self._scheduler = self._start(
            "dask_scheduler", *where, "--port", 0, "--dashboard-address", "127.0.0.1:0", "--no-show"
        )
        end = time.monotonic() + 60
        while (address := self._find_address()) is None:
            assert time.monotonic() < end
            assert self._scheduler.poll() is None, (folder / "dask.txt").read_text()
            time.sleep(0.05)
        self.address = address
        self.workers = [self.start_worker(k) for k in range(workers)]

    def _find_address(self):
        """The scheduler's address; None as long as its file is absent or written in part."""
        try:
            return read_json(self.file)["address"]
        except InputError:
            return None

    def start_worker(self, number):
        options = "--nthreads", 1, self._nanny, "--no-dashboard", "--name", number
        options = *options, "--host", "127.0.0.1", "--local-directory", self._folder / f"worker{number}"
        return self._start("dask_worker", self.address, *options)

    def kill_worker(self, number):
        os.kill(self.workers[number].pid, signal.SIGKILL)

    def _start(self, program, *arguments):
        command = [sys.executable, "-m", f"distributed.cli.{program}", *map(str, arguments)]
        path = os.pathsep.join(path or os.getcwd() for path in sys.path)
        environment = {**os.environ, **SETTINGS, "PYTHONPATH": path, "PYTHONWARNINGS": "ignore"}
        return subprocess.Popen(command, env=environment, stdout=self._log, stderr=subprocess.STDOUT)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        for process in (*self.workers, self._scheduler):
            process.kill()
        for process in (*self.workers, self._scheduler):
            process.wait()
        self._log.close()
