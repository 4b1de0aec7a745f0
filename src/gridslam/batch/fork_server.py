"""The process that children are forked from: it has imported gridslam, so that a child starts in milliseconds.

It gets a request a line on standard input, forks, waits for the child, and writes a reply a line to standard output;
all are JSON. It has one child at a time and no threads. When standard input ends, which it also does when the worker is
killed, it kills its child and exits; when it is killed itself, Linux kills the child.
"""

from __future__ import annotations

import ctypes
import faulthandler
import gc
import importlib
import json
import os
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NoReturn

from gridslam.errors import GridslamError
from gridslam.io.output import OutputFolder

__all__ = ["execute", "read_tail", "serve", "serve_once"]

_TAIL_BYTES = 4000  # of the output of a job

_PR_SET_PDEATHSIG = 1


def serve() -> None:
    """Serve requests until standard input ends."""
    replies = _keep_for_replies()
    wakeup, waker = os.pipe()
    os.set_blocking(wakeup, False)
    os.set_blocking(waker, False)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    pending = b""
    while True:
        while b"\n" not in pending:
            block = os.read(0, 1 << 16)
            if not block:
                return
            pending += block
        line, _, pending = pending.partition(b"\n")
        request = json.loads(line)
        _preload(request["target"])
        reply = _run_child(request, wakeup, replies)
        with suppress(BrokenPipeError):
            _write_all(replies, json.dumps(reply).encode() + b"\n")


def serve_once() -> None:
    """Serve one request in this process itself, on systems that cannot fork; the reply is the result alone."""
    replies = _keep_for_replies()
    request = json.loads(sys.stdin.readline())
    _write_all(replies, json.dumps(execute(request)).encode() + b"\n")


def execute(request: Mapping[str, Any]) -> dict[str, Any]:
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


def _keep_for_replies() -> int:
    """Give a descriptor of standard output of its own; whatever else is printed goes to standard error."""
    replies = os.dup(1)
    os.dup2(2, 1)
    return replies


def _preload(target: str) -> None:
    """Import the module of a target of gridslam here, so that children need not; others are imported by the child."""
    module = target.partition(":")[0]
    if module.startswith("gridslam.") and module not in sys.modules:
        with suppress(Exception):  # the child reports it
            importlib.import_module(module)
            gc.collect()
            gc.freeze()  # children share these pages


def _run_child(request: Mapping[str, Any], wakeup: int, replies: int) -> dict[str, Any]:
    """Fork, wait until the child ends or its time is over, and describe its end."""
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as result:
        kills = _count_oom_kills()
        started = time.perf_counter()
        server = os.getpid()
        pid = os.fork()
        if pid == 0:
            os.close(replies)
            _be_child(request, server, output, result)
        status, usage, timed_out = _wait(pid, request["timeout_s"], wakeup)
        wall_s = time.perf_counter() - started
        exit_code = os.waitstatus_to_exitcode(status)
        result.seek(0)
        text = result.read()
        return {
            "exit_code": exit_code,
            "timed_out": timed_out,
            "out_of_memory": exit_code == -signal.SIGKILL and not timed_out and _count_oom_kills() > kills,
            "wall_s": wall_s,
            "cpu_s": usage.ru_utime + usage.ru_stime,
            "peak_memory_bytes": usage.ru_maxrss * (1 if sys.platform == "darwin" else 1024),
            "result": json.loads(text) if text and exit_code == 0 else None,
            "output_tail": read_tail(output),
        }


def _be_child(request: Mapping[str, Any], server: int, output: IO[bytes], result: IO[bytes]) -> NoReturn:
    """Call the target in the process that was forked, and end it."""
    status = 1
    try:
        os.setsid()
        _die_with_parent(server)
        signal.set_wakeup_fd(-1)
        for number in (signal.SIGCHLD, signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        devnull = os.open(os.devnull, os.O_RDONLY)
        os.dup2(devnull, 0)
        os.dup2(output.fileno(), 1)
        os.dup2(output.fileno(), 2)
        faulthandler.enable(file=2)
        _limit(request["memory_bytes"])
        answer = json.dumps(execute(request)).encode()
        sys.stdout.flush()
        sys.stderr.flush()
        _write_all(result.fileno(), answer)
        status = 0
    except BaseException as error:
        _lift_memory_limit()
        traceback.print_exception(error)
        sys.stderr.flush()
    finally:
        os._exit(status)


def _die_with_parent(server: int) -> None:
    """Let Linux kill this process when the server ends; elsewhere it goes on to its end."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != server:  # it has ended before
            os._exit(1)


def _limit(memory_bytes: int | None) -> None:
    """Limit the address space, and write no core file."""
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


def _wait(pid: int, timeout_s: float | None, wakeup: int) -> tuple[int, Any, bool]:
    """Wait for a child and kill what is left of its group; gives its status, usage and whether its time was over."""
    deadline = None if timeout_s is None else time.monotonic() + timeout_s
    timed_out = False
    while True:
        done, status, usage = os.wait4(pid, os.WNOHANG)
        if done:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)  # what the child may have left
            return status, usage, timed_out and os.waitstatus_to_exitcode(status) != 0
        left_s = None if deadline is None else max(0.0, deadline - time.monotonic())
        ready, _, _ = select.select([0, wakeup], [], [], left_s)
        if wakeup in ready:
            os.read(wakeup, 1 << 12)
        if 0 in ready:  # no request comes before the reply: the worker has ended
            _kill_group(pid)
            os.waitpid(pid, 0)
            os._exit(1)
        if deadline is not None and time.monotonic() >= deadline:
            timed_out = True
            deadline = None
            _kill_group(pid)


def _kill_group(pid: int) -> None:
    """Kill a child and its group; it may not have made its group yet."""
    for kill in (os.killpg, os.kill):
        with suppress(ProcessLookupError, PermissionError):
            kill(pid, signal.SIGKILL)


def read_tail(output: IO[bytes]) -> str:
    """Return the last bytes of a file as text."""
    size = output.seek(0, os.SEEK_END)
    output.seek(max(0, size - _TAIL_BYTES))
    return output.read().decode("utf-8", "replace")


def _count_oom_kills() -> int:
    """Number of processes that Linux has killed because memory was short, as far as it counts them."""
    try:
        lines = Path("/proc/vmstat").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) for line in lines if line.startswith("oom_kill ")), 0)


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]
