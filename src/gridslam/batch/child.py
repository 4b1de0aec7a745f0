"""`run_job`, the one function that workers import: a job in a child process, and the row of whatever became of it."""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, final

from gridslam import __version__
from gridslam.batch.fork_server import read_tail
from gridslam.errors import GridslamError, OutputError
from gridslam.io.staging import StagingFolder

__all__ = ["ForkServer", "LostWorkerError", "attempts_folder", "lost_row", "remove_partial", "run_job"]

_CAN_FORK = hasattr(os, "fork")
_BOOT = "import sys; sys.path[:] = sys.argv[1:]; from gridslam.batch.fork_server import {0}; {0}()"
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_END_S = 5.0
_LOOK_S = 1.0

_of_thread = threading.local()


class LostWorkerError(GridslamError):
    """A worker ended while it ran a job, which may be run again elsewhere."""


def run_job(job: dict[str, Any], limits: dict[str, Any]) -> dict[str, Any]:
    """Run a job in a child process; each thread of a worker has a server of its own that the children come from.

    Parameters
    ----------
    job : dict
        A `Job`, as `Job.to_dict` returns it.
    limits : dict
        ``out``: OUT, the folder of the batch; ``timeout_s``: time limit in s, or None; ``memory_bytes``: limit of the
        address space (Linux), or None; ``attempts``: how often the job may be begun, by any worker; ``version``: that
        of gridslam.

    Returns
    -------
    dict
        The row of the journal: its columns, ``document`` an object or None. Whatever becomes of the child is a row with
        status "failed", a named ``error`` and the last bytes of its output.

    Raises
    ------
    LostWorkerError
        The server that the child came from was killed.
    OutputError
        This machine does not have OUT, or has another version of gridslam.
    """
    if not hasattr(_of_thread, "server"):
        _of_thread.server = ForkServer()
    server: ForkServer = _of_thread.server
    return server.run(job, limits)


@final
class ForkServer:
    """A process that children are forked from (see `fork_server`), and the worker's end of it; started when needed."""

    def __init__(self) -> None:
        """Start nothing yet."""
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False
        self._starting = threading.Lock()

    def run(self, job: Mapping[str, Any], limits: Mapping[str, Any]) -> dict[str, Any]:
        """Run a job as `run_job` does."""
        host = socket.gethostname()
        if limits["version"] != __version__:
            raise OutputError(f"worker {host} has gridslam {__version__}, and the batch is of {limits['version']}")
        claim = attempts_folder(limits["out"]) / job["folder"]
        attempt = _claim_attempt(claim, host)
        if attempt > limits["attempts"]:
            return lost_row(job, attempt - 1)
        started = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        folder = Path(limits["out"]) / job["folder"]
        request = {
            "target": job["target"],
            "arguments": job["arguments"],
            "out": os.fspath(folder),
            "job": {name: job[name] for name in ("key", "command", "log", "folder")},
            "timeout_s": limits["timeout_s"],
            "memory_bytes": limits["memory_bytes"],
        }
        reply = self._ask(request, claim) if _CAN_FORK else _spawn(request)
        row = _start_row(job, attempt) | {
            "exit_status": reply["exit_code"],
            "output_tail": reply["output_tail"],
            "wall_s": reply["wall_s"],
            "cpu_s": reply["cpu_s"],
            "peak_memory_bytes": reply["peak_memory_bytes"],
            "started": started,
            "worker": f"{host}:{os.getpid() if self._process is None else self._process.pid}",
        }
        result = reply["result"] or {}
        if "document" in result:
            return row | {"status": "done", "document": result["document"]}
        remove_partial(folder)
        error, message = _name_failure(reply, result, limits["timeout_s"])
        return row | {"error": error, "message": message}

    def close(self) -> None:
        """Kill the server, which ends its child, and wait until both have ended."""
        with self._starting:
            self._closed = True
        if self._process is not None:
            _end(self._process)

    def _ask(self, request: Mapping[str, Any], claim: Path) -> dict[str, Any]:
        """Send a request to the server, which is started first where there is none, and wait for the reply.

        When the batch ends it removes the claim of the job, and the child is killed.
        """
        with self._starting:
            if self._closed:
                raise LostWorkerError("the worker was ended")
            if self._process is None:
                self._process = _start("serve", stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        line = b""
        with suppress(OSError, ValueError):  # ValueError: closed by another thread
            process.stdin.write(json.dumps(request).encode() + b"\n")
            process.stdin.flush()
            while not select.select([process.stdout], [], [], _LOOK_S)[0]:
                if not claim.exists():
                    raise OSError("the batch has ended")
            line = process.stdout.readline()
        if line.endswith(b"\n"):
            reply: dict[str, Any] = json.loads(line)
            return reply
        _end(process)
        self._process = None
        raise LostWorkerError(f"worker {process.pid} ended while it ran a job")


def attempts_folder(out: str | Path) -> Path:
    """Folder of OUT, there as long as a batch runs, in which workers count how often each job was begun."""
    return Path(out) / ".attempts"


def _claim_attempt(claim: Path, host: str) -> int:
    """Count a beginning of a job by a byte in its file; gives its number, from 1.

    So also a scheduler that repeats a job by itself cannot exceed the limit.
    """
    try:
        descriptor = os.open(claim, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
    except FileNotFoundError:
        raise OutputError(f"{claim.parents[1]}: worker {host} does not see this folder of a running batch") from None
    try:
        os.write(descriptor, b"+")
        return os.fstat(descriptor).st_size
    finally:
        os.close(descriptor)


def lost_row(job: Mapping[str, Any], attempts: int) -> dict[str, Any]:
    """Row of a job all of whose workers were lost."""
    times = "1 worker that ran it was" if attempts == 1 else f"all {attempts} workers that ran it were"
    return _start_row(job, attempts) | {"error": "lost worker", "message": f"{times} killed or ended"}


def remove_partial(folder: Path) -> None:
    """Remove what a killed process has left of a job's results."""
    with suppress(OSError):
        StagingFolder(folder.parent, folder.name).remove()
        if folder.is_dir():
            StagingFolder(folder, folder.name).remove()


def _start_row(job: Mapping[str, Any], attempts: int) -> dict[str, Any]:
    return {
        **{name: job[name] for name in ("key", "log", "command", "folder")},
        "status": "failed",
        "error": None,
        "message": None,
        "output_tail": None,
        "exit_status": None,
        "attempts": attempts,
        "wall_s": None,
        "cpu_s": None,
        "peak_memory_bytes": None,
        "started": None,
        "worker": None,
        "document": None,
    }


def _name_failure(reply: Mapping[str, Any], result: Mapping[str, Any], timeout_s: float | None) -> tuple[str, str]:
    """Name of a child's failure, and one line about it."""
    if reply["timed_out"]:
        return "timeout", f"killed after {timeout_s:g} s"
    if result:
        return result["error"], result["message"]
    code = reply["exit_code"]
    if reply["out_of_memory"] or "bad_alloc" in reply["output_tail"] or "MemoryError" in reply["output_tail"][-200:]:
        return "out of memory", "killed by the system" if code < 0 else "ended without a result"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return name, f"ended by {name}"
    return "exit", f"ended with status {code} and without a result"


def _start(program: str, **pipes: Any) -> subprocess.Popen[bytes]:  # noqa: ANN401
    """Start one of the programs of `fork_server`, in a session of its own: Ctrl-C does not reach it."""
    environment = {**dict.fromkeys(_BLAS_THREADS, "1"), **os.environ}
    command = [sys.executable, "-c", _BOOT.format(program), *(path or os.getcwd() for path in sys.path)]
    return subprocess.Popen(command, env=environment, start_new_session=True, **pipes)


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a server, which kills its child, and wait for it."""
    assert process.stdin is not None
    with suppress(OSError, ValueError):
        process.stdin.close()
    try:
        process.wait(_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    assert process.stdout is not None
    process.stdout.close()


def _spawn(request: Mapping[str, Any]) -> dict[str, Any]:
    """Run a request in a process of its own, on systems that cannot fork; its memory is not limited."""
    began = time.perf_counter()
    with tempfile.TemporaryFile() as output:
        process = _start("serve_once", stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=output)
        timed_out = False
        try:
            answer, _ = process.communicate(json.dumps(request).encode() + b"\n", request["timeout_s"])
        except subprocess.TimeoutExpired:
            timed_out = True
            process.kill()
            answer, _ = process.communicate()
        return {
            "exit_code": process.returncode,
            "timed_out": timed_out,
            "out_of_memory": False,
            "wall_s": time.perf_counter() - began,
            "cpu_s": None,
            "peak_memory_bytes": None,
            "result": json.loads(answer) if answer.endswith(b"\n") and not process.returncode else None,
            "output_tail": read_tail(output),
        }
