"""Run a job in a process of its own, which ends with the batch, and return a row with its outcome."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final

from gridslam.api.peak_memory import find_peak_memory_bytes
from gridslam.batch.job import Job
from gridslam.batch.journal import COLUMNS
from gridslam.errors import GridslamError
from gridslam.io.output import OutputFolder, remove_abandoned

_ONE_THREAD: Final = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
_LOOK_S = 0.05
_TAIL_BYTES = 4000  # of the output of a job


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
    request = {
        "target": job.target,
        "arguments": job.arguments,
        "out": os.fspath(out / job.folder),
        "job": job.summary(),
    }
    end = _run_child(request, timeout_s, stopped)
    row = start_row(job) | {"started": started} | {name: end[name] for name in COLUMNS if name in end}
    if "document" in end:
        return row | {"status": "done"}
    for folder in (out, out / job.folder):  # the latter is there where an earlier run of it has ended
        remove_abandoned(folder, job.folder)
    error, message = _name_failure(end, timeout_s)
    return row | {"error": error, "message": message}


def start_row(job: Job) -> dict[str, Any]:
    """Return the row of a job that has not ended yet."""
    return dict.fromkeys(COLUMNS) | job.summary() | {"status": "failed"}


def _name_failure(end: Mapping[str, Any], timeout_s: float | None) -> tuple[str, str]:
    """Name of a child's failure, and one line about it."""
    if "error" in end:
        return end["error"], end["message"]
    if end["timed_out"]:
        return "timeout", f"killed after {timeout_s:g} s"
    code = end["exit_status"]
    if "bad_alloc" in end["output_tail"] or "MemoryError" in end["output_tail"][-200:]:
        return "out of memory", "ended without a result"
    if code < 0:
        name = signal.Signals(-code).name
        return name, f"ended by {name}" + ", as Linux ends programs where memory is short" * (code == -signal.SIGKILL)
    return "exit", f"ended with status {code} and without a result"


def _run_child(request: Mapping[str, Any], timeout_s: float | None, stopped: threading.Event) -> dict[str, Any]:
    """Run a request in a child until it ends, its time is over or the batch is stopped; describe its end."""
    code = f"import sys; sys.path[:] = {sys.path!r}; from gridslam.batch.child import main; main()"
    with tempfile.TemporaryDirectory() as folder, Path(folder, "output").open("w+b") as output:
        result = Path(folder, "result")
        began = time.monotonic()
        child = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-c", code, str(result)],
            stdin=subprocess.PIPE,
            stdout=output,
            stderr=output,
            env=_ONE_THREAD | os.environ,
            start_new_session=True,
        )
        timed_out = False
        try:
            assert child.stdin is not None
            with suppress(BrokenPipeError):  # it has ended at once
                child.stdin.write(json.dumps(request).encode() + b"\n")
                child.stdin.flush()
            while child.poll() is None and not timed_out and not stopped.wait(_LOOK_S):
                timed_out = timeout_s is not None and time.monotonic() - began >= timeout_s
        finally:
            _kill_group(child.pid)  # what the child may have left, too
            child.communicate()
        return {
            "exit_status": child.returncode,
            "timed_out": timed_out,
            "wall_s": time.monotonic() - began,
            "output_tail": _read_tail(output.name),
            **(json.loads(result.read_text(encoding="utf-8")) if child.returncode == 0 and result.exists() else {}),
        }


def _read_tail(path: str) -> str:
    return Path(path).read_bytes()[-_TAIL_BYTES:].decode("utf-8", "replace")


def _kill_group(pid: int) -> None:
    """Kill a child and all that it has started."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)


def main() -> None:
    """Run the request on standard input in this process, a child, and write the outcome to the file of its argument."""
    request = json.loads(sys.stdin.readline())
    threading.Thread(target=_end_with_batch, daemon=True).start()
    end = _execute(request)
    end |= {"cpu_s": time.process_time(), "peak_memory_bytes": find_peak_memory_bytes()}
    Path(sys.argv[1]).write_text(json.dumps(end), encoding="utf-8")


def _end_with_batch() -> None:
    """Wait until the process of the batch has ended, which closes the pipe, and kill this child and its group."""
    os.read(0, 1)
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
    except BaseException as error:
        if not isinstance(error, GridslamError | OSError):
            traceback.print_exception(error)
        return {"error": type(error).__name__, "message": " ".join(str(error).split())[:500] or type(error).__name__}


def _finish(request: Mapping[str, Any], document: Mapping[str, Any]) -> dict[str, Any]:
    """Write run.json with the key of the job, unless the target has done so: from then on the job is done."""
    marked = {**document, "job": request["job"]}
    if document.get("job") != request["job"]:
        with OutputFolder(request["out"]) as out:
            out.file("run.json").write_text(json.dumps(marked, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return marked
