"""A batch that is killed again and again, and started again each time."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time

OPTIONS = "--workers", "2", "--", "--particles", "3"


def kill_and_repeat(logs, out, kills, rng, most_s):
    """Run `gridslam batch` and kill it after random times up to `most_s`; then run it to its end.

    The time counts from when jobs begin, and each fourth time from the start of the process.

    Checks that what was done is not done again and that in the end all is; gives how many were done at each kill.
    """
    command = [sys.executable, "-m", "gridslam", "batch", str(logs), "-o", str(out), *OPTIONS]
    done = {}
    counts = []
    for kill in range(kills + 1):
        left = set(out.glob(".*.partial"))
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
            while kill % 4 and run.poll() is None and set(out.glob(".*.partial")) <= left:
                time.sleep(0.01)
            try:
                run.wait(None if kill == kills else rng.uniform(0, most_s))
            except subprocess.TimeoutExpired:
                os.kill(run.pid, signal.SIGKILL)
        now = find_done(out)
        changed = {name: (state, now.get(name)) for name, state in done.items() if now.get(name) != state}
        assert not changed, f"kill {kill}: {changed}"
        done = now
        counts.append(len(done))
    assert run.returncode == 0
    names = {path.name.partition(".")[0] for path in logs.iterdir()}
    assert set(done) == names
    assert {path.name for path in out.iterdir()} == {"runs.sqlite", *names}
    assert sorted(read_column(out, "folder")) == sorted(names)
    assert set(read_column(out, "status")) == {"done"}
    for name in names:
        document = json.loads((out / name / "run.json").read_text())
        assert document["job"]["folder"] == name
    return counts


def find_done(out):
    """Which jobs are done, and the file by which: one that is written again is another file.

    Results that a kill has left in a temporary folder, whole or not, are not done.
    """
    found = {}
    for path in out.glob("[!.]*/run.json"):
        if "job" in json.loads(path.read_text()):
            state = path.stat()
            found[path.parent.name] = (state.st_ino, state.st_mtime_ns)
    return found


def read_column(out, name):
    database = sqlite3.connect(out / "runs.sqlite")
    values = [value for (value,) in database.execute(f"SELECT {name} FROM runs")]
    database.close()
    return values
