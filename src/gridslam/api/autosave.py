"""Autosave: save the session of a run periodically; the same command continues it after a kill."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, NamedTuple, final

from gridslam import __version__
from gridslam.api.beginning import Beginning
from gridslam.errors import InputError
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.background_writer import BackgroundWriter
from gridslam.io.sessions.session_file import SavedSession, read_session
from gridslam.pipeline import FailureRecorder
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import StepReport

__all__ = ["Autosave"]


@final
class Autosave:
    """Writes a run to a file periodically, in a thread of its own, so that it can continue after a kill.

    The file is of no use to another run: it names what the run depends on, and is refused where that differs.

    Parameters
    ----------
    path : str or Path
        The session file; removed by `remove` once the results are written.
    period_s : float, s, > 0
        Time between two of them.
    on_failure : callable
        Called with a failure, such as a full disk; the run continues.
    on_resume : callable
        Called with the number of scans that an interrupted run had processed, before the run continues from there.
    """

    def __init__(
        self,
        path: str | Path,
        period_s: float,
        on_failure: Callable[[str], None] = lambda problem: None,
        on_resume: Callable[[int], None] = lambda scans: None,
    ) -> None:
        self.path = Path(path)
        self.period_s = period_s
        self._on_resume = on_resume
        self._due_s = time.monotonic() + period_s
        self._begun: tuple[SavedSession, Beginning] | None = None
        self._job = ""
        self._passed = 0
        self._writer = BackgroundWriter(lambda problem: on_failure(f"the run cannot be saved: {problem}"))

    def find(self, job: Mapping[str, Any], threads: int = 1) -> Beginning | None:
        """Return the autosave of an interrupted run of the same job, or None.

        Parameters
        ----------
        job : mapping
            All that the results depend on, as JSON values.
        threads : int
            Threads of the kernels.

        Raises
        ------
        InputError
            The file is no session, is damaged, or belongs to another job: it may be all that is left of that.
        """
        self._job = hashlib.sha256(json.dumps(job, sort_keys=True).encode()).hexdigest()
        if not self.path.exists():
            return None
        saved = read_session(self.path, threads)
        own = _read_progress(saved.job)
        if own is None or own.job != self._job or saved.version != __version__ or saved.run is None:
            expected = "the autosave of an interrupted run of the same log, configuration and seed"
            raise InputError(self.path, f"expected {expected}, got that of another run (--restart replaces it)")
        self._on_resume(own.passed)
        failures = FailureRecorder(own.failed, own.first_failure)
        return Beginning(saved.run, saved.pieces, own.passed, failures=failures)

    def begin(self, session: SavedSession, beginning: Beginning) -> None:
        """Begin with a session to which a log is added, and with the beginning of its run."""
        self._begun = session, beginning
        self._passed = beginning.passed
        self._due_s = time.monotonic() + self.period_s

    def go_on(self, beginning: Beginning) -> None:
        """Continue with the beginning of a new piece of the same log."""
        if self._begun is not None:
            self._begun = self._begun[0], beginning

    def count(self, measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        """Count the measurements on their way to the filter."""
        for measurement in measurements:
            self._passed += 1
            yield measurement

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Save the run if it is time to."""
        if time.monotonic() < self._due_s or self._writer.is_busy:
            return
        self._writer.report()
        if self._begun is None:
            return
        session, begun = self._begun
        so_far = begun.go_on(state)
        job = json.dumps(_Progress(self._job, self._passed, so_far.failures.count, so_far.failures.first))
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        self._writer.write(self.path, replace(session, run=so_far.run, pieces=so_far.pieces, job=job, written=now))
        self._due_s = time.monotonic() + self.period_s

    def close(self) -> None:
        """Wait until the current file is written."""
        self._writer.close()

    def remove(self) -> None:
        """Remove the file: the results are written."""
        self.close()
        self.path.unlink(missing_ok=True)


@final
class _Progress(NamedTuple):
    """The job of a run and its progress: the entry `job` of its file."""

    job: str
    """Digest of all that its results depend on."""
    passed: int
    """Number of scans of its log that it has processed."""
    failed: int
    first_failure: str


def _read_progress(text: str) -> _Progress | None:
    """Read the part `job` of a file; None where it is none of an interrupted run."""
    try:
        progress = _Progress(*json.loads(text))
    except (ValueError, TypeError):
        return None
    are_typed = all(type(value) is kind for value, kind in zip(progress, (str, int, int, str), strict=True))
    return progress if are_typed and min(progress.passed, progress.failed) >= 0 else None
