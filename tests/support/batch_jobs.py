"""Jobs whose children end in every way, for the tests of `gridslam.batch`.

Each child imports this module: what only the tests need is imported where it is used.
"""

import ctypes
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from dataclasses import asdict
from itertools import islice
from pathlib import Path

from gridslam.batch.job import Job, compute_key
from gridslam.errors import InputError
from gridslam.io.output import OutputFolder


def make_job(function, name, **arguments):
    """A job of a function of this module; what only counts is no part of the key."""
    key = compute_key("test", function, {"name": name, **arguments})
    return Job(f"support.batch_jobs:{function}", arguments, f"{name}.clf", name, key, "test")


def map_job(log, name):
    """A job that maps a log with few particles."""
    from gridslam.config import Configuration
    from gridslam.io.log import LogOptions
    from gridslam.parameters import to_table

    arguments = {
        "log": str(log),
        "configuration": to_table(Configuration(particles=3)),
        "seed": 0,
        "threads": 1,
        "repair": "needed",
        "options": asdict(LogOptions()),
        "max_memory_bytes": 10**9,
        "reference": None,
    }
    return Job("gridslam.batch.commands:run_map", arguments, str(log), name, compute_key("map", name, arguments))


def write_logs(folder, count, scans=40):
    """Write the beginnings of drives through one building, with noise of their own."""
    import numpy as np

    from gridslam.io.carmen.writer import write_carmen
    from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

    folder.mkdir()
    lidar = LidarConfig(beams=90)
    for seed in range(count):
        rng = np.random.default_rng(seed)
        log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), lidar, rng)
        write_carmen(folder / f"log{seed:03d}.clf", islice(log.measurements, scans))
    return sorted(folder.iterdir())


def with_faults(healthy, broken, hanging, greedy, crashing):
    """Jobs of a fleet: the healthy ones with the others among them, in a fixed order."""
    jobs = [
        *healthy,
        *(make_job("reject", f"broken{k}") if k % 2 else map_job("absent.clf", f"broken{k}") for k in range(broken)),
        *(make_job("hang", f"hanging{k}") for k in range(hanging)),
        *(make_job("take_memory", f"greedy{k}") for k in range(greedy)),
        *(make_job("segfault", f"crashing{k}") for k in range(crashing)),
    ]
    random.Random(0).shuffle(jobs)
    return jobs


def check_faults(rows, out, **expected):
    """Each fault has its name, and nothing is left of what failed: no process, no file."""
    names = {"broken": "InputError", "hanging": "timeout", "greedy": "out of memory", "crashing": "SIGSEGV"}
    assert Counter(row["error"] for row in rows if row["status"] == "failed") == {
        names[kind]: count for kind, count in expected.items()
    }
    for row in rows:
        assert row["error"] == names.get(row["folder"].rstrip("0123456789")), row
    done = {row["folder"] for row in rows if row["status"] == "done"}
    assert {path.name for path in out.iterdir()} == {"runs.sqlite", *done}
    assert not list(out.rglob(".*"))
    assert not children_of(os.getpid())


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
            file.write(f"{arguments['job']['folder']}\n")


def write_number(arguments):
    """Write two files, slowly if wanted, and leave run.json to the caller."""
    count(arguments)
    with OutputFolder(arguments["out"]) as folder:
        folder.file("number.txt").write_text(str(arguments["number"]))
        time.sleep(arguments.get("seconds", 0))
        folder.file("square.txt").write_text(str(arguments["number"] ** 2))
    print("a line of output")
    return {"schema": "test.number/1", "number": arguments["number"]}


def reject(arguments):
    count(arguments)
    raise InputError("broken.clf", arguments.get("problem", "expected a scan"), 3)


def fail(arguments):
    raise ValueError("two\nlines")


def fill_disk(arguments):
    raise OSError(28, os.strerror(28), "trajectory.tum")


def hang(arguments):
    """Hang with a child of its own and a file half written."""
    with OutputFolder(arguments["out"]) as folder:
        folder.file("half.txt").write_text("half")
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        if "pids" in arguments:
            Path(arguments["pids"]).write_text(f"{os.getpid()} {child.pid} {os.getppid()}")
        print("now it hangs", flush=True)
        time.sleep(600)


def take_memory(arguments):
    import resource  # not of Windows

    resource.setrlimit(resource.RLIMIT_AS, (2 * 10**9, 2 * 10**9))
    return {"size": len(bytearray(10 * 10**9))}


def segfault(arguments):
    with OutputFolder(arguments["out"]) as folder:
        folder.file("half.txt").write_text("half")
        ctypes.string_at(0)


def kill_itself(arguments):
    os.kill(os.getpid(), signal.SIGKILL)


def leave(arguments):
    os._exit(7)


def return_nonsense(arguments):
    return {"value": float("nan")}
