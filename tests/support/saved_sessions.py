"""A session as this version writes it: two days in a suite of rooms, the second one not found in the first.

    python tests/support/saved_sessions.py FILE

wrote `tests/unit/io/session_N.gridslam`, N the number of the schema, once: a file of an earlier schema is never written
again.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

import gridslam
from gridslam.config import override
from gridslam.io.csv import write_csv_log
from gridslam.io.sessions.session_file import SavedSession, write_session
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate


def make_session() -> SavedSession:
    """Make it; logs are named without a folder."""
    rng = np.random.default_rng(0)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=40), rng)
    session = gridslam.Session(override(gridslam.Configuration(), "particles=2", "mapper.resolution_m=0.1"), seed=4)
    with tempfile.TemporaryDirectory() as folder:
        for name, begin in (("monday", 0), ("tuesday", 60)):
            path = Path(folder) / f"{name}.csv"
            write_csv_log(path, log.measurements[begin : begin + 60])
            session.add(path, place="elsewhere", repair="none")
        session.save(Path(folder) / "session.gridslam")
    saved = session.saved
    run = replace(saved.run, logs=tuple(_name(log) for log in saved.run.logs))
    pieces = [
        replace(
            piece, drives=tuple(replace(drive, logs=tuple(_name(log) for log in drive.logs)) for drive in piece.drives)
        )
        for piece in saved.pieces
    ]
    return replace(saved, run=run, pieces=tuple(pieces))


def _name(log):
    return replace(log, path=Path(log.path).name)


if __name__ == "__main__":
    write_session(sys.argv[1], make_session())
