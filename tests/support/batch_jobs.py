"""Jobs whose children end in every way, for the tests of `gridslam.batch`: this module stands in for the command line.

Each child imports this module: what only the tests need is imported where it is used.
"""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from gridslam.batch.job import Job, compute_key
from gridslam.cli import find_start_s
from gridslam.errors import GridslamError, InputError
from gridslam.io.output import OutputFolder

PROGRAM = "support.batch_jobs"


def make_job(function, name, **arguments):
    """A job of a function of this module; what only counts is no part of the key."""
    key = compute_key("test", function, {"name": name, **arguments})
    return Job((function, json.dumps(arguments)), f"{name}.clf", name, key, "test")


def children_of(pid):
    """Processes whose parent this is, zombies included."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        if int(fields[1]) == pid:
            found.append(path.parent.name)
    return found


def count(arguments):
    """Leave a trace of a call: a line with the name of the job."""
    if "trace" in arguments:
        with Path(arguments["trace"]).open("a") as file:
            file.write(f"{Path(arguments['out']).name}\n")


def write_number(arguments):
    """Write two files, slowly if wanted."""
    count(arguments)
    with OutputFolder(arguments["out"]) as folder:
        folder.file("number.txt").write_text(str(arguments["number"]))
        time.sleep(arguments.get("seconds", 0))
        folder.file("square.txt").write_text(str(arguments["number"] ** 2))
    print("a line of output", file=sys.stderr)
    costs = {"time": {"cpu_s": time.process_time()}, "peak_memory_bytes": 10**8}
    return {"schema": "test.number/1", "number": arguments["number"], **costs}


def describe_process(arguments):
    """State what is imported before the job imports anything, and when the process began."""
    return {"modules": sorted(sys.modules), "start_s": find_start_s()}


def reject(arguments):
    count(arguments)
    raise InputError("broken.clf", arguments.get("problem", "expected a scan"), 3)


def fail(arguments):
    raise ValueError("two lines")


def hang(arguments):
    """Hang with a child of its own and a file half written."""
    with OutputFolder(arguments["out"]) as folder:
        folder.file("half.txt").write_text("half")
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        if "pids" in arguments:
            Path(arguments["pids"]).write_text(f"{os.getpid()} {child.pid} {os.getppid()}")
        print("now it hangs", file=sys.stderr, flush=True)
        time.sleep(600)


def want_memory(arguments):
    raise MemoryError


def leave_out_scans(arguments):
    failure = "2 scans failed: MemoryError"
    print(f"gridslam: {failure}", file=sys.stderr)
    return {"failures": [failure]}


def segfault(arguments):
    with OutputFolder(arguments["out"]) as folder:
        folder.file("half.txt").write_text("half")
        ctypes.string_at(0)


def kill_itself(arguments):
    os.kill(os.getpid(), signal.SIGKILL)


def leave(arguments):
    os._exit(7)


def main(words):
    """Call the function that is named as the command line calls a command, and return an exit status."""
    function, text, _, out, *_ = words
    try:
        print(json.dumps(globals()[function]({**json.loads(text), "out": out})))
    except GridslamError as error:
        print(f"gridslam: {error}", file=sys.stderr)
        return 2
    except MemoryError:
        print("gridslam: out of memory", file=sys.stderr)
        return 1
    return 0
