"""Run a command of a case within its process: it ends with status 0, or is refused with status 2 and one line."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np

from gridslam.cli.main import main
from gridslam.errors import InputError

Prepare = Callable[[Path, np.random.Generator], None]
Read = Callable[[Path], object]


def run_command(where: Path) -> None:
    """Run the command whose arguments a case holds; one that is refused must leave nothing behind."""
    before = {*where.iterdir()}
    try:
        _run_main(where, json.loads((where / "arguments.json").read_text()))
    except InputError:
        left = {*where.iterdir()} - before - {where / "stderr.txt"}
        assert not left, f"left behind: {sorted(path.name for path in left)}"
        raise


def _run_main(where: Path, arguments: list[str]) -> None:
    """Run the command line; raises InputError where it refuses."""
    with (
        open(where / "stderr.txt", "w") as errors,
        open(os.devnull, "w") as nothing,
        redirect_stderr(errors),
        redirect_stdout(nothing),
    ):
        os.dup2(errors.fileno(), 2)  # what is not written by way of sys.stderr
        status = main(arguments)
    text = (where / "stderr.txt").read_text().strip()
    lines = text.splitlines() or [""]
    assert status in (0, 2), f"status {status}: {lines[-1]}"
    assert "Traceback" not in text, lines[-1]
    if status == 2:
        assert len(lines) == 1, f"{len(lines)} lines: {text[:200]}"
        assert text.startswith("gridslam: "), text
        raise InputError(where, text)
