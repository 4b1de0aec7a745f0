"""Run a job's command line in a process of its own, and return a row with its outcome."""

from __future__ import annotations

import faulthandler
import importlib
import json
import math
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final, NamedTuple, cast

from gridslam.batch.job import Job
from gridslam.batch.journal import COLUMNS
from gridslam.io.output import remove_abandoned

PROGRAM: Final = "gridslam.cli.main"
"""Module whose function `main` runs the words of a command line and returns an exit status."""
_PRELOADED: Final = (
    PROGRAM,
    "gridslam.cli.session_options",
    "gridslam.cli.map",
    "gridslam.cli.localize",
    "gridslam.cli.evaluate",
    "gridslam.viz",
    "scipy.sparse.csgraph",  # these three only close loops
    "scipy.special",
    "qdldl",
)
"""Modules that the server imports once, from which children are forked: each would need a second for them."""
_CONTEXT: Any = multiprocessing.get_context(
    "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else None
)
_STARTING = threading.Lock()
"""Held to start a child or to read its exit status: a start reads those of all others, and each can be read once."""
_LOOK_S = 0.05
_TAIL_BYTES = 4000  # of the output of a job
_DONE: Final = (0, 3)  # exit statuses: 3 is the doctor's of a log with faults
_ERRORS: Final = {1: "failed", 2: "bad input", 70: "bug"}
"""Names of the exit statuses of gridslam."""


class _End(NamedTuple):
    """How a child has ended: its exit status, None if its time was over, standard output and the end of the error."""

    status: int | None
    printed: bytes
    tail: str


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
    row: dict[str, Any] = dict.fromkeys(COLUMNS) | {
        "key": job.key,
        "command": job.command,
        "log": job.log,
        "folder": job.folder,
        "status": "failed",
        "started": datetime.now(timezone.utc).isoformat(timespec="milliseconds"),
    }
    began = time.monotonic()
    due = math.inf if timeout_s is None else began + timeout_s
    folder = out / job.folder
    with tempfile.TemporaryDirectory() as scratch:
        words = [*job.words, "--out", os.fspath(folder), "--json"]
        if job.configuration:
            file = Path(scratch, "configuration.toml")
            file.write_text(job.configuration, encoding="utf-8")
            words += ["--config", os.fspath(file)]
        end = _run_child(words, due, stopped, Path(scratch))
        document = _read_document(end)
        if document is not None and job.scoring:
            words = ["evaluate", os.fspath(folder / "trajectory.tum"), *job.scoring, "--json"]
            scored = _run_child(words, due, stopped, Path(scratch))
            end = scored._replace(tail=end.tail + scored.tail)
            scores = _read_document(end)
            document = None if scores is None else {**document, "evaluation": scores}
    row |= {"exit_status": end.status, "wall_s": time.monotonic() - began, "output_tail": end.tail}
    if document is not None:
        costs = {"cpu_s": document.get("time", {}).get("cpu_s"), "peak_memory_bytes": document.get("peak_memory_bytes")}
        return row | costs | {"status": "done", "document": document}
    for where in (out, folder):  # the latter is there where an earlier run of it has ended
        remove_abandoned(where, job.folder)
    error, message = _name_failure(end, timeout_s)
    return row | {"error": error, "message": message}


def _read_document(end: _End) -> dict[str, Any] | None:
    """Return the printed document; None if the child failed, or lacked memory for a part of its result."""
    if end.status not in _DONE:
        return None
    document: dict[str, Any] = json.loads(end.printed)
    return None if any("MemoryError" in failure for failure in document.get("failures", ())) else document


def _name_failure(end: _End, timeout_s: float | None) -> tuple[str, str]:
    """Name of a child's failure, and one line about it."""
    if end.status is None:
        return "timeout", f"killed after {timeout_s:g} s"
    message = (end.tail.strip().splitlines() or [""])[-1].removeprefix("gridslam: ")
    if any(sign in end.tail for sign in ("bad_alloc", "MemoryError", "out of memory")):
        return "out of memory", message or "ended without a result"
    if end.status < 0:
        name = signal.Signals(-end.status).name
        why = ", as Linux ends programs where memory is short" * (end.status == -signal.SIGKILL)
        return name, f"ended by {name}{why}"
    return _ERRORS.get(end.status, "exit"), message or f"ended with status {end.status} and without a result"


def _run_child(words: Sequence[str], due: float, stopped: threading.Event, scratch: Path) -> _End:
    """Run a command line until it ends, its time is over or the batch is stopped."""
    printed, reported = scratch / "stdout", scratch / "stderr"
    place = os.getcwd(), dict(os.environ), os.fspath(printed), os.fspath(reported)
    child = _CONTEXT.Process(target=_run_program, args=(PROGRAM, words, *place))

    def status() -> int | None:
        with _STARTING:
            return cast("int | None", child.exitcode)

    with _STARTING:
        _CONTEXT.set_forkserver_preload([*_PRELOADED])
        child.start()
    try:
        while status() is None and time.monotonic() < due and not stopped.wait(_LOOK_S):
            pass
    finally:
        is_late = status() is None and time.monotonic() >= due
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)  # with what it may have started, too
        child.kill()  # if it was no group yet
        while status() is None:
            time.sleep(_LOOK_S)
    tail = reported.read_bytes()[-_TAIL_BYTES:].decode("utf-8", "replace") if reported.exists() else ""
    return _End(None if is_late else status(), printed.read_bytes() if printed.exists() else b"", tail)


def _run_program(
    program: str, words: Sequence[str], folder: str, environment: Mapping[str, str], printed: str, reported: str
) -> None:
    """Run a command line in this process, a group of its own, of which the output goes to two files."""
    os.setsid()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for stream, path in ((1, printed), (2, reported)):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
    faulthandler.enable()
    sys.exit(importlib.import_module(program).main(words))
