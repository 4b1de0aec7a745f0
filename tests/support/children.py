"""Run a function in a process of its own, forked from this one, within bounds of time and memory."""

from __future__ import annotations

import faulthandler
import os
import resource
import signal
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path

CPU_LIMIT_S = 20  # of CPU time, to which other work on the machine adds nothing
_PATIENCE_S = 200  # for what waits
MEMORY_LIMIT_BYTES = 2 << 30  # beside what this process has already
_ADDRESSES = 4 << 30  # more than the process has


def run_in_child(function: Callable[[], str]) -> str:
    """What the function returns, or how it failed: an exception, a signal, no end, too much memory."""
    receiver, sender = os.pipe()
    _, own = _read_memory()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of other threads, that the case does not need
        process = os.fork()
    if not process:
        os.close(receiver)
        _run(function, sender)
    os.close(sender)
    with open(receiver, "rb") as pipe:
        verdict = pipe.read().decode("utf-8", "replace")
    _, status, used = os.wait4(process, 0)
    if os.WIFSIGNALED(status):
        number = os.WTERMSIG(status)
        hangs = number in (signal.SIGALRM, signal.SIGXCPU, signal.SIGKILL)
        return f"hang: not done after {CPU_LIMIT_S} s" if hangs else signal.Signals(number).name
    taken = used.ru_maxrss * 1024 - own
    if taken > MEMORY_LIMIT_BYTES:
        return f"memory: {taken / 1e9:.1f} GB, {verdict}"
    return verdict


def _read_memory() -> tuple[int, int]:
    """Bytes of this process: of addresses, and in memory."""
    addresses, resident, *_ = Path("/proc/self/statm").read_text().split()
    page = os.sysconf("SC_PAGE_SIZE")
    return int(addresses) * page, int(resident) * page


def _run(function: Callable[[], str], sender: int) -> None:
    """Send the verdict; never returns."""
    verdict = "no verdict"
    try:
        faulthandler.disable()
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(_PATIENCE_S)
        own, _ = _read_memory()
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT_S, CPU_LIMIT_S + 5))
        resource.setrlimit(resource.RLIMIT_AS, (own + _ADDRESSES,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        warnings.simplefilter("ignore")
        verdict = function()
    except MemoryError:
        verdict = "memory: MemoryError"
    except BaseException as error:  # whatever it is, it is the verdict
        where = traceback.extract_tb(error.__traceback__)[-1]
        verdict = f"{type(error).__name__}: {str(error)[:200]} ({Path(where.filename).name}, line {where.lineno})"
    finally:
        os.write(sender, verdict.encode("utf-8", "replace"))
        os._exit(0)
