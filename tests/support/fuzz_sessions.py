"""Sessions whose arrays or head are changed and that are sealed again, and what commands and filters make of them.

A seal shows damage, not what somebody has written: each count, row, id, type and number of a session may be any. A case
passes where the command ends with status 0 and its results, or is refused with status 2, one line and no results.
"""

from __future__ import annotations

import json
import os
import resource
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gridslam
from gridslam.api.session import Session
from gridslam.cli.main import main
from gridslam.config import Configuration, override
from gridslam.errors import InputError
from gridslam.geometry.se2 import between
from gridslam.io.csv import write_csv_log
from gridslam.io.sessions.archive_file import read_sealed_arrays, write_sealed_arrays
from gridslam.io.sessions.drives import DrivenLog
from gridslam.io.sessions.session_file import SESSION_SCHEMA, SavedRun, SavedSession, write_session
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.graph_edits import GraphEdit
from support.changes import INTEGERS, change_array, change_json, choose
from support.loops import PROVOKED, loop_drive

_MEMORY_BYTES = 1 << 30
_Arrays = dict[str, Any]
_Prepare = Callable[[Path, np.random.Generator], None]


def sessions(folder: Path) -> Iterator[tuple[str, _Prepare, Callable[[Path], object], float]]:
    """Name, the two functions and the weight of each family; healthy sessions are made in `folder`."""
    whole = _make_sessions(folder)
    log = (folder / "later.csv").read_bytes()

    def prepare(to: Path, rng: np.random.Generator) -> None:
        names = sorted(whole)
        name = names[rng.integers(len(names))]
        write_sealed_arrays(to / "changed.gridslam", change_session(whole[name], rng))
        command = ("map", "map", "session", "merge")[rng.integers(4)]
        (to / "command.txt").write_text(command)
        (to / "later.csv").write_bytes(log)
        if command == "merge":
            (to / "other.gridslam").write_bytes((folder / "joined.gridslam").read_bytes())

    yield "resealed sessions", prepare, _run_command, 3.0


def change_session(arrays: _Arrays, rng: np.random.Generator) -> _Arrays:
    """Change one or two things of a session, as somebody would who knows its format."""
    changed = dict(arrays)
    for _ in range(rng.choice([1, 1, 2])):
        kinds = (_change_rows, _change_maps, _change_integer, change_array, change_array)
        kind = _change_head if "head" in arrays and not rng.integers(5) else kinds[rng.integers(len(kinds))]
        kind(changed, rng)
    return changed


def _change_rows(arrays: _Arrays, rng: np.random.Generator) -> None:
    """Drop or repeat a row in all arrays of one state that have as many, or in some of them."""
    like = arrays[choose(rng, [name for name in sorted(arrays) if np.ndim(arrays[name])])]
    state = choose(
        rng, sorted({name.rpartition(".")[0] for name in arrays if np.shape(arrays[name])[:1] == like.shape[:1]})
    )
    count = len(like)
    rows = [np.arange(count - 1), np.arange(count + 1) % max(count, 1), np.arange(min(count, 1)), np.arange(0)][
        rng.integers(4)
    ]
    everywhere = rng.integers(3)
    for name, values in arrays.items():
        if name.startswith(state) and np.shape(values)[:1] == (count,) and (everywhere or rng.integers(2)) and count:
            arrays[name] = values[rows]


def _change_maps(arrays: _Arrays, rng: np.random.Generator) -> None:
    """Give a table of maps fewer or more rows, all its ids in use, or move it."""
    tables = sorted(name for name in arrays if name.endswith(".roots"))
    if not tables:
        return
    part = choose(rng, tables).removesuffix(".roots")
    roots = arrays[f"{part}.roots"]
    chosen = [roots[:1], roots[:-1], np.concatenate([roots, roots[:1]]), roots[:, :0], roots[:, :1], roots][
        rng.integers(6)
    ]
    pages_used, roots = _renumber(chosen)
    tiles_used, pages = _renumber(arrays[f"{part}.pages"][pages_used])
    arrays |= {f"{part}.roots": roots, f"{part}.pages": pages}
    for name in (f"{part}.log_odds", f"{part}.field"):
        arrays[name] = arrays[name][tiles_used]
    if not rng.integers(3):
        first = arrays[f"{part}.first"].copy()
        first[rng.integers(2)] += rng.choice([1, -1, 10, 10**6, 2**40])
        arrays[f"{part}.first"] = first


def _renumber(ids: Any) -> tuple[Any, Any]:
    used = np.unique(np.append(0, ids))
    new = np.zeros(int(used.max()) + 1, np.int32)
    new[used] = np.arange(len(used))
    return used, new[ids].astype(np.int32)


def _change_integer(arrays: _Arrays, rng: np.random.Generator) -> None:
    """Set a number of an array of integers: a count, a row, or an id."""
    names = [name for name in sorted(arrays) if np.asarray(arrays[name]).dtype.kind in "iu" and np.size(arrays[name])]
    name = choose(rng, names)
    values = np.array(arrays[name])
    place = rng.integers(values.size)
    near = int(values.flat[place]) + int(rng.choice([-1, 1, 2]))
    number = near if rng.integers(2) else INTEGERS[rng.integers(len(INTEGERS))]
    values.flat[place] = np.array(np.clip(number, -(2**62), 2**62)).astype(values.dtype)
    arrays[name] = values


def _change_head(arrays: _Arrays, rng: np.random.Generator) -> None:
    """Change a value of the head, which is JSON, or a number of the configuration in it."""
    head = json.loads(str(arrays["head"]))
    if not rng.integers(4):
        lines = head["configuration"].splitlines()
        numbers = [k for k, line in enumerate(lines) if line.rpartition("= ")[2].replace(".", "").isdigit()]
        chosen = numbers[rng.integers(len(numbers))]
        value = rng.choice(["0", "1", "2", "7", "100", "1e6", "-1", "0.01", "1e-9", "true", '"x"', "nan"])
        lines[chosen] = f"{lines[chosen].rpartition('= ')[0]}= {value}"
        head["configuration"] = "\n".join(lines) + "\n"
    else:
        head = change_json(head, rng)
    arrays["head"] = np.array(json.dumps(head))


def _run_command(where: Path) -> None:
    """Run the case's command on its session, and look at what it leaves."""
    session, out = str(where / "changed.gridslam"), where / "out"
    command = (where / "command.txt").read_text()
    targets = "-o", str(out), "--save", str(where / "s.gridslam")
    arguments = {
        "map": ["map", str(where / "later.csv"), "--continue", session, *targets],
        "session": ["session", session],
        "merge": ["merge", session, str(where / "other.gridslam"), "-o", str(out)],
    }[command]
    with (
        open(where / "stderr.txt", "w") as errors,
        open(os.devnull, "w") as nothing,
        redirect_stderr(errors),
        redirect_stdout(nothing),
    ):
        os.dup2(errors.fileno(), 2)  # what is not written by way of sys.stderr
        out.mkdir() if command == "session" else None
        status = main([*arguments, "--json"])
    text = (where / "stderr.txt").read_text().strip()
    _require_frugal()
    lines = text.splitlines() or [""]
    assert "Traceback" not in text, lines[-1]
    assert status in (0, 2), f"status {status}: {lines[-1]}"
    left = [path.name for path in where.rglob("*") if "partial" in path.name]
    assert not left, f"left over: {left}"
    results = [path.name for path in (*out.rglob("*"), *where.glob("s.gridslam"))]
    if status == 2:
        assert len(lines) == 1, f"{len(lines)} lines: {text[:200]}"
        assert not results, f"refused, but there are {results}"
        raise InputError(where, text)
    assert results or command == "session", "no results"


def _require_frugal() -> None:
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    assert used < _MEMORY_BYTES, f"{used >> 20} MB"


def _make_sessions(folder: Path) -> dict[str, _Arrays]:
    """A session joined of two drives, runs while a loop is closed and corrected, and a log to go on with."""
    rooms, rng = make_world("rooms", np.random.default_rng(5)), np.random.default_rng(3)
    log = simulate(rooms, RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    first, second = log.measurements[:200], log.measurements[100:250]
    write_csv_log(folder / "first.csv", first)
    write_csv_log(folder / "second.csv", second)
    write_csv_log(folder / "later.csv", log.measurements[250:260])
    session = Session(override(Configuration(), "particles=3"), seed=1)
    session.add(folder / "first.csv", repair="none")
    joined = session.add(folder / "second.csv", pose=between(log.truth.poses[0], log.truth.poses[100]), repair="none")
    assert joined.found_again is not None
    session.save(folder / "joined.gridslam")
    edits = (
        GraphEdit((0, 9)),
        GraphEdit((1, 8), Constraint(1, 8, np.zeros(3), np.eye(3), ConstraintSource.BY_HAND, True)),
    )
    write_session(folder / "edited.gridslam", replace(session.saved, edits=edits))
    _save_while_closing(folder, loop_drive())
    names = ("joined", "edited", "pending", "correction")
    return {name: read_sealed_arrays(folder / f"{name}.gridslam", SESSION_SCHEMA, "a session") for name in names}


def _save_while_closing(folder: Path, log: SimulatedLog) -> None:
    """Save a run while its graph is solved, and while its map is drawn again."""
    slow = override(PROVOKED, "loop_closure.scans_per_step=5", "loop_closure.poses_per_scan=1")
    begun = SavedRun(np.random.default_rng(1), name="day", logs=(DrivenLog("day.csv", "", 1, 0, 1, 1.0),))
    slam, state = gridslam.build(slow), None
    observers = [begun.trajectory, begun.statistics]
    for measurement in log.measurements:
        state = gridslam.run([measurement], replace(slam, particles=4), rng=begun.rng, observers=observers, state=state)
        closure = state.closure_state
        is_during = {
            "pending": closure.pending_constraints is not None,
            "correction": closure.correction is not None and closure.correction.inserted > 9,
        }
        for name in (
            name for name, is_now in is_during.items() if is_now and not (folder / f"{name}.gridslam").exists()
        ):
            run = replace(begun, state=state)
            write_session(folder / f"{name}.gridslam", SavedSession(slow, run=run))
        if (folder / "correction.gridslam").exists():
            return
