"""Run a job in a child process, and return a row with its outcome.

Children come from a server of the standard library that has imported gridslam (forkserver of `multiprocessing`), so
that they begin in milliseconds; each has one job, and ends with the batch.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import multiprocessing
import os
import signal
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

from gridslam.batch.job import Job
from gridslam.batch.journal import COLUMNS
from gridslam.errors import GridslamError
from gridslam.io.output import OutputFolder
from gridslam.io.staging import remove_abandoned

_METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
_PRELOADED = [
    "__main__",
    "gridslam.batch.commands",
    "gridslam.viz.picture",
    "PIL.PngImagePlugin",
    "scipy.sparse",
    "qdldl",
]
_BLAS_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
_LOOK_S = 0.2
_STARTS = 20
_TAIL_BYTES = 4000  # of the output of a job

_children = threading.Lock()
"""Held where a child is started or its status read: two threads that read one status would lose it."""


def run_job(job: Job, out: Path, stopped: threading.Event, *, timeout_s: float | None = None) -> dict[str, Any]:
    """Run a job in a child process, which is killed when the batch is `stopped`.

    Parameters
    ----------
    job : Job
        What to run.
    out : Path
        OUT, the absolute path of the folder of the batch.
    stopped : threading.Event
        Set when the batch ends.
    timeout_s : float, optional
        Time limit, s.

    Returns
    -------
    dict
        The row of the journal: its columns, ``document`` an object or None. Every outcome of the child is a row with
        status "failed", a named ``error`` and the last bytes of its output.
    """
    started = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
    folder = out / job.folder
    request = {
        "target": job.target,
        "arguments": job.arguments,
        "out": os.fspath(folder),
        "job": job.summary(),
    }
    end = _run_child(request, timeout_s, stopped)
    row = start_row(job) | {"started": started}
    row |= {name: end.get(name) for name in ("exit_status", "output_tail", "wall_s", "cpu_s", "peak_memory_bytes")}
    if "document" in end:
        return row | {"status": "done", "document": end["document"]}
    remove_partial(folder)
    error, message = _name_failure(end, timeout_s)
    return row | {"error": error, "message": message}


def remove_partial(folder: Path) -> None:
    """Remove partial results that a killed process left of a job."""
    with suppress(OSError):
        remove_abandoned(folder.parent)
        remove_abandoned(folder)


def start_row(job: Job) -> dict[str, Any]:
    """Return the row of a job that has not ended yet."""
    return dict.fromkeys(COLUMNS) | job.summary() | {"status": "failed"}


def _name_failure(end: Mapping[str, Any], timeout_s: float | None) -> tuple[str, str]:
    """Name of a child's failure, and one line about it."""
    if end["timed_out"]:
        return "timeout", f"killed after {timeout_s:g} s"
    if "error" in end:
        return end["error"], end["message"]
    code = end["exit_status"]
    if "bad_alloc" in end["output_tail"] or "MemoryError" in end["output_tail"][-200:]:
        return "out of memory", "ended without a result"
    if code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        return name, f"ended by {name}" + ", as Linux ends programs where memory is short" * (code == -signal.SIGKILL)
    return "exit", f"ended with status {code} and without a result"


def _run_child(request: Mapping[str, Any], timeout_s: float | None, stopped: threading.Event) -> dict[str, Any]:
    """Run a request in a child until it ends, its time is over or the batch is stopped; describe its end."""
    with tempfile.TemporaryDirectory() as folder:
        output, result = Path(folder, "output"), Path(folder, "result")
        output.touch()
        ended = timed_out = False
        child = _start(request, output, result)
        began = time.monotonic()  # the first child waits for the server
        try:
            while not (ended := bool(wait([child.sentinel], _LOOK_S))):
                timed_out = timeout_s is not None and time.monotonic() - began >= timeout_s
                if timed_out or stopped.is_set():
                    break
        finally:
            _kill_group(child.pid, ended=ended)  # what the child may have left, too
        wait([child.sentinel])  # one that cannot be killed yet must not stop the others
        with _children:
            child.join()
        code = child.exitcode
        return {
            "exit_status": code,
            "timed_out": timed_out and code != 0,
            "wall_s": time.monotonic() - began,
            "output_tail": output.read_bytes()[-_TAIL_BYTES:].decode("utf-8", "replace"),
            **(json.loads(result.read_text(encoding="utf-8")) if code == 0 and result.exists() else {}),
        }


def _start(request: Mapping[str, Any], output: Path, result: Path) -> BaseProcess:
    """Start the child of a request; the server that it comes from is started first where there is none."""
    context: Any = multiprocessing.get_context(_METHOD)
    if _METHOD == "forkserver":
        context.set_forkserver_preload(_PRELOADED)
    for name in _BLAS_THREADS:
        os.environ.setdefault(name, "1")
    for _ in range(_STARTS):
        with _children, suppress(EOFError, ConnectionError):  # the server was killed a moment ago
            child: BaseProcess = context.Process(target=_work, args=(request, dict(os.environ), output, result))
            child.start()
            return child
        time.sleep(_LOOK_S)
    raise ConnectionError("child processes cannot be started")


def _kill_group(pid: int | None, *, ended: bool = False) -> None:
    """Kill the group of a child and the child, which may not have made its group yet, unless it has `ended`."""
    assert pid is not None
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(pid, signal.SIGKILL)
    with suppress(ProcessLookupError, PermissionError):
        if not ended:
            os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))


def _work(request: Mapping[str, Any], environment: dict[str, str], output: Path, result: Path) -> None:
    """Run a request in this process, a child; write its output to one file and its outcome to another.

    The environment is that of the batch now: the server keeps the one it was started with.
    """
    os.environ.clear()
    os.environ.update(environment)
    if hasattr(os, "setsid"):
        os.setsid()
    threading.Thread(target=_end_with_batch, daemon=True).start()
    for path, flags, numbers in ((os.devnull, os.O_RDONLY, (0,)), (output, os.O_WRONLY | os.O_APPEND, (1, 2))):
        descriptor = os.open(path, flags)
        for number in numbers:
            os.dup2(descriptor, number)
    faulthandler.enable(file=2)
    _forbid_core_files()
    end = _execute(request) | _measure_cost()
    result.write_text(json.dumps(end), encoding="utf-8")


def _end_with_batch() -> None:
    """Wait until the process of the batch has ended, and kill this child and its group."""
    batch = multiprocessing.parent_process()
    assert batch is not None
    batch.join()
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


def _forbid_core_files() -> None:
    """Let a process that crashes write no core file."""
    with suppress(ImportError):  # Windows
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _measure_cost() -> dict[str, Any]:
    """CPU time and peak memory of this process so far, where the system reports them."""
    if sys.platform == "win32":
        return {}
    import resource

    usage = resource.getrusage(resource.RUSAGE_SELF)
    scale = 1 if sys.platform == "darwin" else 1024
    return {"cpu_s": usage.ru_utime + usage.ru_stime, "peak_memory_bytes": usage.ru_maxrss * scale}
