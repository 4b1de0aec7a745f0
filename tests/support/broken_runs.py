"""What `gridslam map` makes of a damaged log: a map or one named error, within a time limit."""

from __future__ import annotations

import json
import signal
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

import numpy as np

from gridslam.api.conversion import convert_log
from gridslam.api.mapping import map_log
from gridslam.cli.main import main
from gridslam.config import override, preset
from gridslam.doctor import CheckedLog, diagnose
from gridslam.doctor.report import document
from gridslam.errors import InputError
from gridslam.io.log import LogOptions, open_log
from support.broken_logs import broken_logs, whole_logs

_LIMIT_S = 20.0
"""For a log that takes a tenth of a second, on a machine however busy."""
_FORMS = ("log.csv", "log.mcap", "log.tum")
_FILES = {"map.yaml", "map.pgm", "map.png", "trajectory.tum", "trajectory.csv", "run.json", "record.npz"}


def run_broken_logs(folder: Path, count: int, seed: int, whole_command_every: int) -> Counter[str]:
    """Map `count` damaged logs; counts of maps and errors, and of what is neither, with the number of the case.

    A log is cut off as often read as far as it goes as not; every so many-th is given to the command itself.
    """
    return _came(folder, count, seed, lambda number: _by_command if number % whole_command_every == 0 else _by_library)


def read_broken_logs(folder: Path, count: int, seed: int) -> Counter[str]:
    """Diagnose `count` damaged logs and convert them; counts of diagnoses and errors, and of what is neither."""
    return _came(folder, count, seed, lambda number: _diagnosed)


def _came(folder: Path, count: int, seed: int, taker: Callable[[int], Callable[[Path, bool], str]]) -> Counter[str]:
    (folder / "whole").mkdir()
    whole, came = whole_logs(folder / "whole"), Counter[str]()
    for number, (done, name, content) in enumerate(broken_logs(whole, count, seed)):
        path, keep = folder / name, number // len(whole) % 2 == 1
        path.write_bytes(content)
        try:
            with _time_limit():
                what = taker(number)(path, keep)
        except BaseException as error:  # whatever it is, the other cases are to be seen too
            if isinstance(error, KeyboardInterrupt):
                raise
            what = f"{done}: {type(error).__name__}: {error}"
        came[what] += 1
        path.unlink()
    return came


class _HangError(Exception):
    """The time is over."""


@contextmanager
def _time_limit() -> Iterator[None]:
    """Raise where the time is over; where there are no such signals, wait."""
    if sys.platform == "win32":
        yield
        return

    def over(signal_number: int, frame: FrameType | None) -> None:
        raise _HangError(f"not done after {_LIMIT_S:g} s")

    before = signal.signal(signal.SIGALRM, over)
    signal.setitimer(signal.ITIMER_REAL, _LIMIT_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _by_library(path: Path, keep: bool) -> str:
    configuration = override(preset("default", 2), "loop_closure=false")
    try:
        log = CheckedLog(open_log(path, LogOptions(keep_truncated=keep)), lambda found: None)
        result = map_log(log, configuration=configuration)
    except InputError as error:
        return "error" if "\n" not in str(error) else f"{path.name}: more than one line: {error}"
    assert len(result.trajectory.poses) == log.statistics.scan_count > 0
    assert np.isfinite(result.trajectory.poses).all()
    return "map"


def _diagnosed(path: Path, keep: bool) -> str:
    options = LogOptions(keep_truncated=keep)
    try:
        diagnosis = diagnose(open_log(path, options))
    except InputError as error:
        return "error" if "\n" not in str(error) else f"{path.name}: more than one line: {error}"
    json.dumps(document(diagnosis), allow_nan=False)
    with TemporaryDirectory(dir=path.parent) as out:
        for form in _FORMS:
            with suppress(InputError):
                convert_log(path, Path(out) / form, options=options)
                assert form == "log.tum" or list(open_log(Path(out) / form))
    return "diagnosis"


def _by_command(path: Path, keep: bool) -> str:
    out = path.with_name("out")
    arguments = ["map", str(path), "-o", str(out), "--particles", "2", "--no-loop-closure"]
    status = main(arguments + ["--keep-truncated"] * keep)
    found = {file.name for file in out.iterdir()} if out.exists() else set()
    assert (status == 0 and found >= _FILES) or (status == 2 and not out.exists()), f"status {status}, {found}"
    assert {file.name for file in path.parent.iterdir()} <= {path.name, "out", "whole"}
    for file in out.glob("*"):
        file.unlink()
    if out.exists():
        out.rmdir()
    return "map" if status == 0 else "error"
