"""Cases of whole commands, each a process that something happens to: streams, targets, names, limits, signals, options.

A case passes where the command ends by itself within its time with one of its exit statuses, says in lines of its own
why it has failed, leaves no temporary files, and each of its targets as it was or complete.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

import click
import numpy as np

from gridslam.api.session import Session
from gridslam.cli.commands import gridslam
from gridslam.config import Configuration
from gridslam.errors import InputError
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.g2o import write_g2o
from gridslam.io.maps import write_map
from gridslam.io.sessions.session_file import read_head
from gridslam.io.trajectories import write_tum
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam.pose_graph.pose_graph import PoseGraph

__all__ = ["processes"]

_SCANS = 16
_PATIENCE_S = 60.0
_STATUSES = (0, 1, 2, 3, 130)
_SCRIPT = "import sys; from gridslam.cli.main import main; sys.exit(main())"  # as of the installed program
_FEW = ["--particles", "2", "--set", "loop_closure=false"]
_WHOLE = {
    "map": ("map.yaml", "map.pgm", "map.png", "trajectory.tum", "graph.g2o", "record.npz", "run.json"),
    "grid": ("map.yaml", "map.pgm", "map.png", "run.json"),
    "localize": ("trajectory.tum", "trajectory.csv", "belief.csv", "run.json"),
    "landmarks": ("landmarks.csv", "trajectory.tum", "run.json"),
    "graph": ("graph.g2o", "graph.png", "graph.json"),
    "doctor": ("report.md",),
    "merge": ("map.yaml", "map.pgm", "trajectory.tum", "run.json"),
}
"""Files of the folder OUT: there are all of them, or none."""
_COMMANDS: tuple[list[str], ...] = (
    ["map", "log.clf", "-o", "out", *_FEW],
    ["map", "log.clf", "-o", "out", "--save", "s.gridslam", "--particles", "2"],
    ["map", "log.clf", "-o", "old", *_FEW],
    ["map", "log.clf", "-o", "out", "--continue", "a.gridslam", "--save", "new/s.gridslam"],
    ["grid", "log.clf", "--trajectory", "truth.tum", "-o", "out"],
    ["localize", "log.clf", "--map", "map.yaml", "-o", "out", "--particles", "100"],
    ["landmarks", "park.txt", "-o", "out", "--particles", "2"],
    ["graph", "graph.g2o", "-o", "out"],
    ["doctor", "log.clf", "-o", "out"],
    ["doctor", "log.clf"],
    ["convert", "log.clf", "log.bag"],
    ["convert", "log.clf", "log.mcap"],
    ["convert", "log.clf", "folder"],
    ["convert", "log.clf", "log.csv.gz"],
    ["session", "a.gridslam", "--picture", "a.png"],
    ["merge", "a.gridslam", "b.gridslam", "-o", "out", "--save", "s.gridslam"],
    ["evaluate", "truth.tum", "truth.tum"],
    ["simulate", "rooms", "-o", "made.clf.gz", "--duration", "2", "--beams", "20"],
    ["batch", "log.clf", "odd.clf", "-o", "out", "--workers", "2", "--", *_FEW],
    ["batch", "log.clf", "-o", "out", "--command", "doctor"],
    ["dataset", "list"],
    ["map", "--help"],
)
_FAULTS = ("streams", "targets", "names", "limits", "signals", "vanishing", "options")


@dataclass
class _Case:
    """One process.

    Attributes
    ----------
    argv : list of str
        What follows the program.
    environment : dict of str to str
        Beside that of the tests.
    closed, full : list of int
        Standard streams that are closed, or a full device.
    broken : list of int
        Standard streams that nobody reads.
    limits : dict of str to int
        Resource limits by their names.
    signal : int
        One that is sent while it runs, or 0.
    vanishing : str
        Folder that is removed while it runs; empty: none.
    after_s : float
        When that happens, s after the command can be interrupted.
    """

    argv: list[str]
    environment: dict[str, str] = field(default_factory=dict)
    closed: list[int] = field(default_factory=list)
    full: list[int] = field(default_factory=list)
    broken: list[int] = field(default_factory=list)
    limits: dict[str, int] = field(default_factory=dict)
    signal: int = 0
    vanishing: str = ""
    after_s: float = 0.0


Prepare = Callable[[Path, np.random.Generator], None]
Read = Callable[[Path], object]


def processes(folder: Path) -> Iterator[tuple[str, int, Prepare, Read, float]]:
    """Name, point, the two functions and the weight of the family; `folder` gets what the commands read."""
    _make_inputs(folder)
    yield "process faults", 9, partial(_prepare, folder), _run, 3.0


def _make_inputs(folder: Path) -> None:
    folder.mkdir()
    rng = np.random.default_rng(0)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=60), rng)
    write_carmen(folder / "log.clf", log.measurements[:_SCANS])
    (folder / "odd.clf").write_text("FLASER 3 1 2\n")
    write_tum(folder / "truth.tum", log.truth)
    for name, first in (("a", 0), ("b", 8)):
        session = Session(Configuration(particles=2), seed=0)
        write_carmen(folder / f"{name}.clf", log.measurements[first : first + _SCANS])
        result = session.add(folder / f"{name}.clf")
        session.save(folder / f"{name}.gridslam")
    result.save(folder / "old")
    write_map(folder / "map.yaml", result.map)
    poses = np.zeros((3, 3))
    poses[:, 0] = np.arange(3)
    graph = PoseGraph.of(poses, [[0, 1], [1, 2]], [[1.0, 0.0, 0.0]] * 2, [np.eye(3)] * 2)
    write_g2o(folder / "graph.g2o", graph, np.arange(3))
    lines = [f"ODOMETRY {k} {k + 1} 0.5 0 0 0.01 0 0 0.01 0 0.01\nLANDMARK {k + 1} 7 1 0 0.01 0 0.01" for k in range(9)]
    (folder / "park.txt").write_text("\n".join(lines) + "\n")


def _prepare(inputs: Path, to: Path, rng: np.random.Generator) -> None:
    shutil.copytree(inputs, to / "here")
    (to / "tmp").mkdir()
    case = _Case(list(_COMMANDS[rng.integers(len(_COMMANDS))]))
    fault = _FAULTS[rng.integers(len(_FAULTS))]
    _APPLY[fault](case, to / "here", rng)
    (to / "case.json").write_text(json.dumps(asdict(case)))


def _close_streams(case: _Case, here: Path, rng: np.random.Generator) -> None:
    for stream in range(3):
        kind = rng.integers(5)
        if kind == 0:
            case.closed.append(stream)
        elif kind == 1 and stream:
            case.full.append(stream)
        elif kind == 2 and stream:
            case.broken.append(stream)
    if rng.integers(2):
        case.environment = {"PYTHONUTF8": "0", "LC_ALL": str(rng.choice(["C", "xx_YY.ISO-8859-1", "C.UTF-8"]))}


def _targets(case: _Case) -> list[int]:
    """Where the targets stand in the command."""
    found = [k + 1 for k, word in enumerate(case.argv) if word in ("-o", "--save", "--picture")]
    return [2] if case.argv[0] == "convert" else found


def _change_target(case: _Case, here: Path, rng: np.random.Generator) -> None:
    places = _targets(case)
    (here / "nothing").symlink_to("nowhere")
    os.mkfifo(here / "fifo")
    if places:
        place = places[rng.integers(len(places))]
        case.argv[place] = str(
            rng.choice(
                [
                    "/proc/x", "/dev/full", "/dev/null/x", "log.clf/x", "log.clf", "nothing", "nothing/x", "fifo",
                    "x" * 300, "x" * 245, "a/" + "y" * 300 + "/b", "new/folder/x", ".", "/", "..", "old", "a\nb",
                    "\udcff", "out", "made.clf", "old/run.json", " ", "-", "~", "deep/" * 900 + "x", "truth.tum",
                ]
            )
        )  # fmt: skip


def _change_names(case: _Case, here: Path, rng: np.random.Generator) -> None:
    names = [k for k, word in enumerate(case.argv) if (here / word).exists() and word != "old"]
    odd = [
        "ä.clf",
        "\udcff\udcfe",
        "a\nb",
        "x" * 250,
        " ",
        "'\"",
        "%s%n",
        "a:b",
        "\x1b[31m",
        "[x]",
        "*",
        "😀",
        "-x",
        "x" * 300,
    ]
    if names:
        place = names[rng.integers(len(names))]
        name = odd[rng.integers(len(odd))]
        if len(name) < 256:
            shutil.copy(here / case.argv[place], here / name)
        case.argv[place] = name if rng.integers(4) else f"{here}/{name}"
    if rng.integers(2):
        case.environment = {"PYTHONUTF8": "0", "LC_ALL": "C"}


def _limit(case: _Case, here: Path, rng: np.random.Generator) -> None:
    if rng.integers(2):
        case.limits["RLIMIT_FSIZE"] = int(rng.choice([0, 100, 1000, 5000, 20_000, 100_000]))
    else:
        case.limits["RLIMIT_NOFILE"] = int(rng.integers(8, 40))


def _send_signal(case: _Case, here: Path, rng: np.random.Generator) -> None:
    case.signal = int(rng.choice([signal.SIGINT, signal.SIGTERM, signal.SIGHUP]))
    case.after_s = float(rng.uniform(0.0, 0.9))


def _let_vanish(case: _Case, here: Path, rng: np.random.Generator) -> None:
    case.vanishing = str(rng.choice(["below", "below", ".", "../tmp"]))
    case.after_s = float(rng.uniform(0.0, 0.9))
    (here / "below").mkdir()
    for place in _targets(case):
        case.argv[place] = f"below/{case.argv[place]}"


def _change_option(case: _Case, here: Path, rng: np.random.Generator) -> None:
    command: click.Command = gridslam
    for word in case.argv:
        if isinstance(command, click.Group):
            command = command.get_command(click.Context(command), word)
    left_out = {"live", "live_opens", "scheduler", "url"}
    options = [
        parameter
        for parameter in command.params
        if isinstance(parameter, click.Option) and not parameter.is_flag and parameter.name not in left_out
    ]
    values = [
        "inf", "-inf", "nan", "1e300", "-1e300", "1e999", "1e-320", "0", "-0", "-1", "1", "3.5", "1" * 30, "9" * 5000,
        "", " ", "x", "\udcff", "a\nb", "1,2,3", "1e300,1e300,1e300", "x=1", "particles=1e300", "motion.kind=x",
        "[" * 3000, "range_max_m=" + "9" * 5000, "particles=" + "[" * 3000, "ä", "/dev/zero", "log.clf", "old", "1e-6",
    ]  # fmt: skip
    place = case.argv.index("--") if "--" in case.argv else len(case.argv)
    for _ in range(rng.integers(1, 3)):
        if options:
            option = options[rng.integers(len(options))]
            case.argv[place:place] = [option.opts[0], values[rng.integers(len(values))]]


_APPLY: dict[str, Callable[[_Case, Path, np.random.Generator], None]] = dict(
    zip(
        _FAULTS,
        (_close_streams, _change_target, _change_names, _limit, _send_signal, _let_vanish, _change_option),
        strict=True,
    )
)


def _run(where: Path) -> None:
    """Run a case's process, and look at what it has printed and left."""
    case = _Case(**json.loads((where / "case.json").read_text()))
    here = where / "here"
    before = _contents(here)
    began = time.monotonic()
    status, printed = _start(case, where)
    seconds = time.monotonic() - began
    lines = [line for line in printed.splitlines() if line.strip()]
    assert "Traceback" not in printed, lines[-1]
    assert "Exception ignored" not in printed, lines[-1]
    assert status in (*_STATUSES, -case.signal), f"status {status}: {lines[-1:]}"
    assert seconds < 20 + case.after_s, f"it took {seconds:.0f} s"
    if not case.vanishing:
        _check_folder(where, case, before)
    is_silent = 1 in case.broken or 2 in (*case.closed, *case.full, *case.broken)
    if status in (1, 2, 130) and not is_silent:
        assert lines[-1:], f"status {status} without a word"
        assert lines[-1].startswith("gridslam: "), lines[-1]
    if status:
        raise InputError(where, f"status {status}: {' '.join(lines[-1:])}")


def _contents(here: Path) -> dict[str, bytes]:
    return {str(path.relative_to(here)): path.read_bytes() for path in here.rglob("*") if path.is_file()}


def _start(case: _Case, where: Path) -> tuple[int, str]:
    """Start the process, let happen what is to happen, and return its status and what it has printed on stderr."""

    def prepare() -> None:
        for stream in case.full:
            os.dup2(os.open("/dev/full", os.O_WRONLY), stream)
        for stream in case.broken:
            reader, writer = os.pipe()
            os.close(reader)
            os.dup2(writer, stream)
        for stream in case.closed:
            os.close(stream)
        for name, limit in case.limits.items():
            resource.setrlimit(getattr(resource, name), (limit, limit))

    environment = {**os.environ, "TMPDIR": str(where / "tmp"), **case.environment}
    command = [sys.executable, "-c", _SCRIPT, *map(os.fsencode, case.argv)]
    process = subprocess.Popen(
        command,
        cwd=where / "here",
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        preexec_fn=prepare,
    )
    try:
        if case.signal or case.vanishing:
            _await_handlers(process)
            time.sleep(case.after_s)
        if case.signal and process.poll() is None:
            process.send_signal(case.signal)
        if case.vanishing:
            shutil.rmtree(where / "here" / case.vanishing, ignore_errors=True)
        _, printed = process.communicate(timeout=_PATIENCE_S)
    finally:
        process.kill()
        process.wait()
    return process.returncode, printed.decode("utf-8", "replace")


def _await_handlers(process: subprocess.Popen[bytes]) -> None:
    """Wait until the process catches SIGTERM: before, Python itself is being started."""
    while process.poll() is None:
        try:
            status = Path(f"/proc/{process.pid}/status").read_text()
        except OSError:
            return
        caught = next((line for line in status.splitlines() if line.startswith("SigCgt")), "SigCgt: 0")
        if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.002)


def _check_folder(where: Path, case: _Case, before: dict[str, bytes]) -> None:
    """No temporary file is left, what is read is as it was, and a target is as it was or complete."""
    here = where / "here"
    left = [str(path.relative_to(where)) for path in where.rglob("*.partial")]
    kept = [path for path in (where / "tmp").iterdir() if not path.name.startswith("gridslam-bug-")]
    assert not left + kept, f"left: {left} {kept}"
    targets = [case.argv[place] for place in _targets(case) if place < len(case.argv)]
    for name, content in before.items():
        if not any(name == target or name.startswith(f"{target}/") or target in (".", "..", "/") for target in targets):
            assert (here / name).read_bytes() == content, f"{name} was changed"
    _check_whole(here / "out", _WHOLE.get(case.argv[0], ()))
    _check_whole(here / "old", _WHOLE["map"])
    session = here / "s.gridslam"
    if session.exists():
        read_head(session)


def _check_whole(folder: Path, names: Sequence[str]) -> None:
    found = {path.name for path in folder.iterdir()} if folder.is_dir() else set()
    assert not found or found >= set(names), f"{folder.name} has {sorted(found)} alone"
