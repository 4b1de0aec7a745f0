"""One mapping session of the node: from its first scan until time jumps back, a reset or the end; and its files."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime, timezone
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.api.beginning import Beginning
from gridslam.api.mapping import MapResult, finish_mapping
from gridslam.config import Configuration, build
from gridslam.doctor.repair import Repair
from gridslam.errors import GridslamError, OutputError
from gridslam.io.log_statistics import LogStatistics, Mounting
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.drives import DrivenLog
from gridslam.io.sessions.session_file import SavedRun, SavedSession, write_session
from gridslam.io.text import compute_digest
from gridslam.pipeline import FailedStep, FailureRecorder, Observer, Stopwatch, run
from gridslam.ros.node.accepted_scan import AcceptedScan
from gridslam.ros.node.continued import Continued, EarlierDrives, begin
from gridslam.ros.node.messages import Level
from gridslam.ros.node.session import FailureCallback
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.slam.loop_closure.loop_closure import LIBRARIES
from gridslam.types import StepReport


@final
class Session:
    """A mapping session; used by the filter's thread only, but for its copies.

    Parameters
    ----------
    configuration : Configuration
        Configuration of the filter.
    seed, threads : int
        Seed and threads of the filter.
    continued : Continued, optional
        What it goes on from.
    log : callable
        Reports to the user.

    Attributes
    ----------
    state : GridFastSlamState or None
        After the last scan; None before the first one.
    found_after_m : float or None, m
        What the robot had driven in this session when it was found in the map that it goes on from; None before.
    configuration : Configuration
        As given.
    log : LogStatistics
        Of the scans so far.
    record : Path or None
        Of a copy: the file with all its scans; None if there is none.
    """

    restart_message = "starting a new map"

    def __init__(
        self,
        configuration: Configuration,
        seed: int,
        threads: int,
        continued: Continued | None = None,
        log: Callable[[Level, str], None] = lambda level, text: None,
    ) -> None:
        for name in (*LIBRARIES, "gridslam.viz"):  # before the first scan: transforms do not wait for an import
            import_module(name)
        self.state: GridFastSlamState | None = None
        self.continued = continued
        self.found_after_m: float | None = None
        self.configuration = configuration
        self._seed = seed
        self._threads = threads
        self._report = log
        self.log = LogStatistics()
        self._stopwatch = Stopwatch()
        self._failures = FailureRecorder()
        self._begun = Beginning(SavedRun(np.random.default_rng(seed)))
        self._earlier: EarlierDrives | None = None  # until they are prepared
        self._is_prepared = False
        self.record: Path | None = None
        self._is_last = False
        self._messages: Sequence[Mapping[str, Any]] = ()

    def add(self, accepted: AcceptedScan) -> None:
        """Count a measurement before the filter processes it."""
        scan = accepted.measurement.scan
        if scan.sensor not in self.log.mountings:
            pose = np.append(scan.geometry.origin, accepted.mounting[5])
            self.log.mountings[scan.sensor] = Mounting(pose, f"tf, frame {scan.frame}")
        self.log.count(accepted.measurement)

    def run(self, source: Iterator[Measurement], observers: Sequence[Observer], on_failure: FailureCallback) -> None:
        """Run the filter on all measurements of a source; scans at which it fails are skipped."""
        slam = build(self.configuration, self._threads)
        begins = next(source)
        self._begin(begins, slam)
        run_so_far = self._begun.run
        first, *others = observers
        every: list[Observer] = [first, self._attach, run_so_far.trajectory, run_so_far.statistics, self._note, *others]

        def note_failure(failed: FailedStep) -> None:
            self.state = failed.state
            self._failures(failed)
            on_failure(failed)

        run(
            chain([begins], source),
            slam,
            rng=run_so_far.rng,
            observers=every,
            state=run_so_far.state,
            stopwatch=self._stopwatch,
            on_failure=note_failure,
        )

    def copy(
        self, record: Path | None, *, is_last: bool = False, messages: Sequence[Mapping[str, Any]] = ()
    ) -> Session:
        """Copy the session after its first scan, to be saved by another thread while the filter goes on.

        `record` is the file with all scans so far, None if there is none; `is_last`: the filter has ended; `messages`
        are what was reported so far.
        """
        assert self.state is not None
        now = replace(self._begun.run, state=self.state).copy()
        copied = copy.copy(self)
        copied.state = now.state
        copied._begun = replace(self._begun, run=now)
        copied.log, copied._stopwatch, copied._failures = copy.deepcopy((self.log, self._stopwatch, self._failures))
        copied.record = record
        copied._is_last = is_last
        copied._messages = messages
        return copied

    def to_session(self, *, wait: bool = False) -> SavedSession | None:
        """Give what a file of the session holds, to be frozen or written before the next scan; None if there is none.

        There is none before the first scan, and until what earlier drives have left is at hand, unless it may wait.

        Raises
        ------
        GridslamError
            What earlier drives have left cannot be gone on from.
        """
        earlier = self._earlier
        if self.state is None or (earlier is not None and not earlier.is_ready and not wait):
            return None
        so_far = self._whole().go_on(self.state, self._describe_log())
        written = datetime.now(timezone.utc).isoformat(timespec="seconds")
        return SavedSession(self.configuration, self._seed, so_far.run, so_far.pieces, written=written)

    def save(self, folder: str | Path) -> dict[str, Any]:
        """Write the files of `gridslam map` after the final refinement, which takes time; returns run.json's content.

        To be called of a copy.

        Raises
        ------
        OutputError
            The folder cannot be written.
        """
        result = self._compute_result()
        try:
            return result.save(folder, self._messages)
        except OSError as error:
            raise OutputError(f"{folder}: cannot be written: {error.strerror or error}") from None

    def save_session(self, path: str | Path) -> None:
        """Write the session file.

        Raises
        ------
        OutputError
            It cannot be written.
        GridslamError
            What earlier drives have left cannot be gone on from.
        """
        session = self.to_session(wait=True)
        assert session is not None
        write_session(path, session)

    def _whole(self) -> Beginning:
        """Return what the session has begun with, and what earlier drives have left, which may take time."""
        return self._begun if self._earlier is None else self._earlier.add_to(self._begun)

    def _compute_result(self) -> MapResult:
        """Compute the full result, as `gridslam map` does at the end of a log."""
        frozen = self.state
        assert frozen is not None
        self._stopwatch.resume()
        begun = self._begun
        with suppress(GridslamError):  # reported before; the map is that of this drive alone
            begun = self._whole()
        begun = begun.go_on(frozen)  # the copy that is refined does not know in which piece the robot was found
        state = GridFastSlamState.from_arrays(frozen.to_arrays(), self.configuration.mapper, self._threads)
        if self._is_last:
            begun.attach_to(state)
            begun.finish(state, build(self.configuration, self._threads))
        ended = begun.go_on(state, self._describe_log())
        return finish_mapping(
            ended.run,
            self.configuration,
            seed=self._seed,
            threads=self._threads,
            log=self.log,
            source=Path(next(iter(self.log.scans))) if self.record is None else self.record,
            digest="" if self.record is None else compute_digest(self.record),
            repair=Repair(),
            stopwatch=self._stopwatch,
            failures=self._failures.describe(),
            pieces=ended.pieces,
        )

    def _describe_log(self) -> DrivenLog:
        """Describe the scans as a file remembers them."""
        source = ", ".join(self.log.scans) if self.record is None else str(self.record)
        return DrivenLog.of(source, "", self.log)

    def _begin(self, first: Measurement, slam: GridFastSlam) -> None:
        self._begun, is_new = begin(self.continued, first, slam, self._seed, self._report)
        if self.continued is not None and (is_new or self.continued.saved.pieces):
            self._earlier = EarlierDrives(self.continued, self.configuration, self._threads, is_new_drive=is_new)

    def _attach(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Let the filter look for the robot in what earlier drives have left, once that is at hand."""
        if self._earlier is not None and not self._is_prepared and self._earlier.is_ready:
            self._is_prepared = True
            try:
                self._begun = self._earlier.add_to(self._begun)
                self._earlier = None
            except GridslamError as error:
                self._report(Level.ERROR, str(error))
        self._begun.attach(report, state, seconds)

    def _note(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        self.state = state
        joined = self._begun.find_joined(state) if self.found_after_m is None else None
        if joined is not None and state.closure_state is not None:
            self.found_after_m = state.closure_state.driven_before_found_m(len(joined.piece))
            found_in = f"the map of {', '.join(drive.name for drive in joined.drives)}"
            x, y, theta = state.best_pose.tolist()
            place = f"x {x:.2f} m, y {y:.2f} m, heading {math.degrees(theta):.0f} degrees"
            self._report(Level.OK, f"found again in {found_in} after {self.found_after_m:.1f} m, at {place}")
