"""What a mapping session of the node begins with: nothing, or a session file that it goes on from."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import final

import numpy as np

from gridslam.api.beginning import Beginning, decide_place, locate_in
from gridslam.api.session import Session as SavedDrives
from gridslam.config import Configuration
from gridslam.errors import GridslamError
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.background_writer import lower_priority
from gridslam.io.sessions.drives import SavedPiece, choose_name
from gridslam.io.sessions.session_file import SavedRun, SavedSession, read_session
from gridslam.pipeline import describe_error
from gridslam.ros.node.messages import Level
from gridslam.slam.full_slam.earlier_pieces import EarlierPieces
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam

Log = Callable[[Level, str], None]


@final
@dataclass(frozen=True, slots=True, eq=False)
class Continued:
    """A session that the next mapping session goes on from.

    Attributes
    ----------
    path : Path
        Its file.
    saved : SavedSession
        What it holds.
    is_elsewhere : bool
        Whether the robot is not where the last drive has ended; else stamps, odometry and the first scan decide.
    is_in_file : bool
        Whether the file holds it, or what it has begun with: then the session may replace the file.
    """

    path: Path
    saved: SavedSession
    is_elsewhere: bool = False
    is_in_file: bool = True

    @classmethod
    def read(cls, path: str | Path, threads: int = 1) -> Continued:
        """Read a session file; raises InputError if it is none."""
        return cls(Path(path), read_session(path, threads))

    @property
    def names(self) -> list[str]:
        """Names of the drives so far."""
        return [drive.name for drive in self.saved.drives]


@final
class EarlierDrives:
    """Refines what earlier drives have left, by a thread of its own, while the robot maps already.

    Parameters
    ----------
    continued : Continued
        The session.
    configuration : Configuration
        Of the filter.
    threads : int
        Of the kernels.
    is_new_drive : bool
        Whether the drive that the session has ended with is earlier, too; otherwise it goes on.
    """

    def __init__(self, continued: Continued, configuration: Configuration, threads: int, *, is_new_drive: bool) -> None:
        self._continued = continued
        self._configuration = configuration
        self._threads = threads
        self._is_new_drive = is_new_drive
        self._found: tuple[tuple[SavedPiece, ...], EarlierPieces | None] | None = None
        self._problem = ""
        self._thread = threading.Thread(target=self._prepare, name="gridslam-earlier", daemon=True)
        self._thread.start()

    @property
    def is_ready(self) -> bool:
        """Whether `add_to` does not wait."""
        return not self._thread.is_alive()

    def add_to(self, begun: Beginning) -> Beginning:
        """Let a run that has begun look for the robot in what earlier drives have left.

        Raises GridslamError where that cannot be; then nothing may replace the session's file.
        """
        self._thread.join()
        if self._found is None:
            problem = f"{self._continued.path} cannot be gone on from: {self._problem}"
            raise GridslamError(f"{problem}. The robot is not looked for in it, and no session is saved")
        pieces, locator = self._found
        return replace(begun, pieces=pieces, locator=locator)

    def _prepare(self) -> None:
        lower_priority()
        try:
            saved = self._continued.saved
            pieces, run = saved.pieces, saved.run
            if self._is_new_drive or run is None:
                pieces = tuple(SavedDrives.of(saved, threads=self._threads).pieces)
                run = SavedRun(np.random.default_rng(saved.seed))
            self._found = pieces, locate_in(pieces, self._configuration, run)
        except Exception as error:  # reported by the filter's thread
            self._problem = describe_error(error)


def begin(
    continued: Continued | None, first: Measurement, slam: GridFastSlam, seed: int, log: Log
) -> tuple[Beginning, bool]:
    """Decide what a mapping session begins with at its first measurement, and whether that is a new drive."""
    name = datetime.fromtimestamp(1e-9 * first.scan.stamp_ns, timezone.utc).strftime("%Y-%m-%d_%H-%M-%S")
    if continued is None:
        return Beginning(SavedRun(np.random.default_rng(seed), name=name)), True
    saved = continued.saved
    reason = "the newest drive has ended"
    if saved.run is not None:
        decision = decide_place(saved.run, slam, first)
        reason = decision.reason
        if decision.is_same and not continued.is_elsewhere:
            log(Level.OK, f"session {continued.path}: goes on where it has ended: {reason}")
            return Beginning(saved.run.snapshot(), saved.pieces), False
    drives = continued.names
    log(Level.OK, f"session {continued.path}: goes on elsewhere, the robot is looked for in its map: {reason}")
    run = SavedRun(np.random.default_rng(saved.seed + len(drives)), name=choose_name(name, drives))
    return Beginning(run), True
