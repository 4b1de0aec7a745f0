"""Run a job in a child process by `run_job`, the one function that workers import, and return a row with its outcome.

Children come from a server of the standard library that has imported gridslam (forkserver of `multiprocessing`), so
that they begin in milliseconds; each has one job, and ends with the worker.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import multiprocessing
import os
import signal
import socket
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timezone
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from gridslam import __version__
from gridslam.errors import GridslamError, OutputError
from gridslam.io.output import OutputFolder
from gridslam.io.staging import StagingFolder

__all__ = ["LostWorkerError", "attempts_folder", "lost_row", "remove_partial", "run_job"]

_METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
_PRELOADED = ["__main__", "gridslam.batch.commands"]
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_LOOK_S = 0.2
_STARTS = 20
_TAIL_BYTES = 4000  # of the output of a job
_SERVER_ENDED = 255  # what multiprocessing gives as the exit status of a child whose server was killed

_children = threading.Lock()
"""Held where a child is started or its status read: two threads that read one status would lose it."""


class LostWorkerError(GridslamError):
    """A worker ended while it ran a job, which may be run again elsewhere."""


def run_job(job: dict[str, Any], limits: dict[str, Any]) -> dict[str, Any]:
    """Run a job in a child process.

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
        The row of the journal: its columns, ``document`` an object or None. Every outcome of the child is a row with
        status "failed", a named ``error`` and the last bytes of its output.

    Raises
    ------
    LostWorkerError
        The server that the child came from was killed, or the batch has ended.
    OutputError
        This machine does not have OUT, or has another version of gridslam.
    """
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
        "memory_bytes": limits["memory_bytes"],
    }
    end = _run_child(request, limits["timeout_s"], claim)
    row = _start_row(job, attempt) | {
        "exit_status": end["exit_status"],
        "output_tail": end["output_tail"],
        "wall_s": end["wall_s"],
        "cpu_s": end.get("cpu_s"),
        "peak_memory_bytes": end.get("peak_memory_bytes"),
        "started": started,
        "worker": f"{host}:{os.getpid()}",
    }
    if "document" in end:
        return row | {"status": "done", "document": end["document"]}
    remove_partial(folder)
    error, message = _name_failure(end, limits["timeout_s"])
    return row | {"error": error, "message": message}


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
    """Return row of a job all of whose workers were lost."""
    times = "1 worker that ran it was" if attempts == 1 else f"all {attempts} workers that ran it were"
    return _start_row(job, attempts) | {"error": "lost worker", "message": f"{times} killed or ended"}


def remove_partial(folder: Path) -> None:
    """Remove partial results that a killed process left of a job."""
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


def _name_failure(end: Mapping[str, Any], timeout_s: float | None) -> tuple[str, str]:
    """Name of a child's failure, and one line about it."""
    if end["timed_out"]:
        return "timeout", f"killed after {timeout_s:g} s"
    if "error" in end:
        return end["error"], end["message"]
    code = end["exit_status"]
    if end["out_of_memory"] or "bad_alloc" in end["output_tail"] or "MemoryError" in end["output_tail"][-200:]:
        return "out of memory", "killed by the system" if code < 0 else "ended without a result"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return name, f"ended by {name}"
    return "exit", f"ended with status {code} and without a result"


def _run_child(request: Mapping[str, Any], timeout_s: float | None, claim: Path) -> dict[str, Any]:
    """Run a request in a child until it ends, its time is over or the batch has ended; describe its end.

    When the batch ends it removes the claim of the job, and the child is killed.
    """
    with tempfile.TemporaryDirectory() as folder:
        output, result = Path(folder, "output"), Path(folder, "result")
        output.touch()
        kills = _count_oom_kills()
        ended = timed_out = False
        child = _start(request, output, result)
        began = time.monotonic()  # the first child waits for the server
        try:
            while not (ended := bool(wait([child.sentinel], _LOOK_S))):
                timed_out = timeout_s is not None and time.monotonic() - began >= timeout_s
                if timed_out or not claim.exists():
                    break
        finally:
            _kill_group(child.pid, ended=ended)  # what the child may have left, too
        wait([child.sentinel])  # one that cannot be killed yet must not stop the others
        with _children:
            child.join()
        code = child.exitcode
        if code == _SERVER_ENDED or not claim.exists():
            raise LostWorkerError(f"worker {os.getpid()} ended while it ran a job")
        return {
            "exit_status": code,
            "timed_out": timed_out and code != 0,
            "out_of_memory": code == -signal.SIGKILL and not timed_out and _count_oom_kills() > kills,
            "wall_s": time.monotonic() - began,
            "output_tail": output.read_bytes()[-_TAIL_BYTES:].decode("utf-8", "replace"),
            **(json.loads(result.read_text(encoding="utf-8")) if code == 0 and result.exists() else {}),
        }


def _start(request: Mapping[str, Any], output: Path, result: Path) -> BaseProcess:
    """Start the child of a request; the server that it comes from is started first where there is none."""
    context: Any = multiprocessing.get_context(_METHOD)
    if _METHOD == "forkserver":
        context.set_forkserver_preload(_PRELOADED)
    # A Dask nanny runs its worker as a daemon, which may have no children; ours end with the worker.
    vars(multiprocessing.current_process())["_config"].pop("daemon", None)
    for name in _BLAS_THREADS:
        os.environ.setdefault(name, "1")
    for _ in range(_STARTS):
        with _children, suppress(EOFError, ConnectionError):  # the server was killed a moment ago
            child: BaseProcess = context.Process(target=_work, args=(request, dict(os.environ), output, result))
            child.start()
            return child
        time.sleep(_LOOK_S)
    raise LostWorkerError(f"worker {os.getpid()} ended before it ran a job")


def _kill_group(pid: int | None, *, ended: bool = False) -> None:
    """Kill the group of a child and the child, which may not have made its group yet, unless it has `ended`."""
    assert pid is not None
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(pid, signal.SIGKILL)
    with suppress(ProcessLookupError, PermissionError):
        if not ended:
            os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))


def _count_oom_kills() -> int:
    """Return number of processes that Linux has killed because memory was short, as far as it counts them."""
    try:
        lines = Path("/proc/vmstat").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("oom_kill ")), 0)


def _work(request: Mapping[str, Any], environment: dict[str, str], output: Path, result: Path) -> None:
    """Run a request in this process, a child; write its output to one file and its outcome to another.

    The environment is that of the worker now: the server keeps the one it was started with.
    """
    os.environ.clear()
    os.environ.update(environment)
    if hasattr(os, "setsid"):
        os.setsid()
    threading.Thread(target=_end_with_worker, daemon=True).start()
    for path, flags, numbers in ((os.devnull, os.O_RDONLY, (0,)), (output, os.O_WRONLY | os.O_APPEND, (1, 2))):
        descriptor = os.open(path, flags)
        for number in numbers:
            os.dup2(descriptor, number)
    faulthandler.enable(file=2)
    _limit(request["memory_bytes"])
    end = _execute(request) | _measure_cost()
    result.write_text(json.dumps(end), encoding="utf-8")


def _end_with_worker() -> None:
    """Wait until the worker has ended, and kill this child and its group."""
    worker = multiprocessing.parent_process()
    assert worker is not None
    worker.join()
    _kill_group(os.getpid())


def _execute(request: Mapping[str, Any]) -> dict[str, Any]:
    """Call the target of a request in this process.

    Returns
    -------
    dict
        ``document``, what the target returned; or ``error`` and ``message``, the name of what it raised and one line.
        The traceback of an exception that is not gridslam's own goes to standard error.
    """
    try:
        module, _, name = request["target"].partition(":")
        target = getattr(importlib.import_module(module), name)
        document = target({**request["arguments"], "out": request["out"], "job": request["job"]})
        document = _finish(request, document)
        json.dumps(document, allow_nan=False)
        return {"document": document}
    except MemoryError as error:
        _lift_memory_limit()
        return {"error": "out of memory", "message": f"memory is short: {error}".removesuffix(": ")}
    except (GridslamError, OSError) as error:
        return {"error": type(error).__name__, "message": " ".join(str(error).split())}
    except BaseException as error:
        traceback.print_exception(error)
        return {"error": type(error).__name__, "message": " ".join(str(error).split())[:500] or type(error).__name__}


def _finish(request: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    """Write run.json with the key of the job, unless the target has done so: from then on the job is done."""
    marked = {**document, "job": request["job"]}
    if document.get("job") != request["job"]:
        with OutputFolder(request["out"]) as out:
            out.file("run.json").write_text(json.dumps(marked, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return marked


def _limit(memory_bytes: int | None) -> None:
    """Limit the address space, and write no core file."""
    if sys.platform == "win32":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory_bytes is not None and sys.platform == "linux":
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        if hard != resource.RLIM_INFINITY:
            memory_bytes = min(memory_bytes, hard)
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, hard))


def _lift_memory_limit() -> None:
    """Give a process whose memory is short enough to report it."""
    with suppress(ImportError, OSError, ValueError):
        import resource

        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (hard, hard))


def _measure_cost() -> dict[str, Any]:
    """CPU time and peak memory of this process so far, where the system reports them."""
    if sys.platform == "win32":
        return {}
    import resource

    usage = resource.getrusage(resource.RUSAGE_SELF)
    scale = 1 if sys.platform == "darwin" else 1024
    return {"cpu_s": usage.ru_utime + usage.ru_stime, "peak_memory_bytes": usage.ru_maxrss * scale}
