"""The node without a transport: it passes incoming messages through `gridslam.pipeline` and publishes the results."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, TimeoutError
from contextlib import contextmanager, suppress
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np

from gridslam.config import Configuration
from gridslam.doctor import EarlyCheck, Finding
from gridslam.doctor.view_breaks import DriveNumbering
from gridslam.errors import ArgumentError, ConfigurationError, GridslamError, OutputError
from gridslam.io.measurement import Measurement
from gridslam.messages import Level, Messages
from gridslam.particles import sample_gaussian
from gridslam.pipeline import FailedStep, Observer, describe_error, isolate
from gridslam.ros.node.accepted_scan import AcceptedScan, ScanRecorder
from gridslam.ros.node.continued import Continued
from gridslam.ros.node.live_autosave import LiveAutosave, SessionFiles
from gridslam.ros.node.mapping_session import Session
from gridslam.ros.node.measurement_queue import MeasurementQueue, SessionEnd
from gridslam.ros.node.messages import Diagnostics, GridMessage, Outputs, ScanMessage, StampedTransform
from gridslam.ros.node.parameters import NodeSettings
from gridslam.ros.node.rendering import MapRenderer, make_grid_message
from gridslam.ros.node.session import InitialPose, Localization, LocalizationSession
from gridslam.ros.node.state_publisher import StatePublisher
from gridslam.tracking.tracker import OdometryTracker

SourceWrapper: TypeAlias = Callable[[Iterator[Measurement]], Iterator[Measurement]]
DiagnosticsCallback: TypeAlias = Callable[[Diagnostics], None]

_DIAGNOSTICS_S = 1.0
_FOUND = (SessionEnd.JUMP, SessionEnd.CARRIED)
"""Ends that nobody asked for, at which the session is saved."""


@final
class NodeCore:
    """Maps a live lidar stream.

    Callbacks never wait for the filter. A session begins with its first scan, and ends by a reset, where time jumps
    back and the robot is elsewhere (a bag played again), or where it was carried: then it is looked for in the map.

    Parameters
    ----------
    settings : NodeSettings
        Frames, rates and bounds.
    configuration : Configuration or Localization
        Configuration of the filter; `Localization` if the map is known.
    outputs : Outputs
        The transport that publishes the node's messages.
    record : str or Path, optional
        CSV of the accepted scans, which `gridslam map` maps with identical results; later sessions, and those of a node
        that is started again, get `-2`, `-3`, ... before its suffix.
    observers : sequence of Observer
        Called after each scan in the filter's thread.
    files : SessionFiles, optional
        The session that the first one goes on from, whose configuration must be given, and where to save.

    Attributes
    ----------
    results_folder : Path
        Where people who ask for it save the results while the node runs.
    messages : Messages
        What was reported so far.
    failure : BaseException or None
        The exception that ended the filter's thread; None after `close`.
    ended : threading.Event
        Set when the filter's thread has ended.

    Raises
    ------
    ConfigurationError
        The filter needs odometry, and the settings allow it to be missing.
    OutputError
        The record cannot be created.
    """

    def __init__(
        self,
        settings: NodeSettings,
        configuration: Configuration | Localization,
        outputs: Outputs,
        *,
        record: str | Path | None = None,
        observers: Sequence[Observer] = (),
        files: SessionFiles | None = None,
    ) -> None:
        by_odometry = isinstance(configuration, Localization) or isinstance(configuration.tracker, OdometryTracker)
        if settings.odometry != "needed" and by_odometry:
            raise ConfigurationError(f"odometry: expected needed, as this filter requires it, got {settings.odometry}")
        self.settings = settings
        self.configuration = configuration
        self.results_folder = Path("gridslam-map")
        self.failure: BaseException | None = None
        self.ended = threading.Event()
        self._outputs = outputs
        self._observers = list(observers)
        self._wrappers: list[SourceWrapper] = []
        self._diagnostics_callbacks: list[DiagnosticsCallback] = []
        self._record = None if record is None else Path(record)
        self._recorder: ScanRecorder | None = None
        self.messages = self._warn = Messages(outputs.log)
        self._queue = MeasurementQueue(settings, self._warn)
        self._known_map: GridMessage | None = None
        self._renderer: MapRenderer | None = None
        if isinstance(configuration, Configuration):
            self._renderer = MapRenderer(configuration.mapper, settings, outputs.map)
        self._publisher = StatePublisher(settings, outputs, self._renderer, self._queue, self._warn)
        self._continued = None if files is None else files.continued
        self._goes_on = None if files is None else files.path
        self._session_end = SessionEnd.CLOSED
        self._drive = 0
        self._certain: deque[tuple[int, AcceptedScan]] = deque()  # scans, and the number of their drive
        self._begin_session()
        self._begin_record()
        self._timers: list[tuple[str, float, Callable[[], None]]] = [
            ("transform", settings.transform_publish_period_s, self._publisher.publish_transform),
            ("diagnostics", _DIAGNOSTICS_S, self._publish_diagnostics),
            ("map", settings.map_update_interval_s, lambda: self._queue.post(self._publish_map)),
        ]
        self._autosave: LiveAutosave | None = None
        if files is not None and files.autosave is not None:
            self._autosave = LiveAutosave(files, self.messages.report)
            self._timers.append(("autosave", files.autosave_period_s, lambda: self._queue.post(self._save_now)))
        self._threads = [threading.Thread(target=self._run_filter, name="gridslam-filter", daemon=True)]

    def add_observer(
        self, observer: Observer, wrap_source: SourceWrapper = iter, on_diagnostics: DiagnosticsCallback | None = None
    ) -> None:
        """Add an observer before `start`; all callbacks run in the filter's thread.

        `observer` is called after each scan, `wrap_source` gets the measurements of each session and yields them, and
        `on_diagnostics` gets the diagnostics once per second; all in the filter's thread.
        """
        self._observers.append(observer)
        self._wrappers.append(wrap_source)
        if on_diagnostics is not None:
            self._diagnostics_callbacks.append(on_diagnostics)

    def await_input(self, scans: str, frames: str = "") -> None:
        """Report the topic of the scans, and the frames whose transform the node needs besides."""
        self._publisher.facts.awaited = f"scans on {scans}" + (f" and {frames}" if frames else "")
        self._publisher.facts.scans_on = scans
        self._publisher.log_state()

    def start(self) -> None:
        """Start the node's threads and accept messages."""
        if isinstance(self.configuration, Localization):
            self._show_known_map(make_grid_message(self.configuration.known.grid, self.settings, 0))
        self._threads += [
            threading.Thread(target=self._run_timer, args=(period_s, callback), name=f"gridslam-{name}", daemon=True)
            for name, period_s, callback in self._timers
            if period_s
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> Session | None:
        """Stop the node and return a copy of the session to save; None if no scan was mapped."""
        self._queue.end_session(SessionEnd.CLOSED)
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        if self.failure is None:
            self._publisher.facts.is_closed = True
            with suppress(Exception):  # of who looks on: what was mapped is written all the same
                self._report_state(lambda call: call())
        if self._renderer is not None:
            self._renderer.close()
        copied = None if self.mapped_session is None else self._copy_mapped(is_last=True)
        if self._autosave is not None:
            self._autosave.close()
            self._save_now(wait=True)
            self._autosave.close()
        self._close_record()
        return copied

    def on_scan(self, message: ScanMessage, sensor: str = "scan") -> None:
        """Queue a scan of the topic `sensor`; never blocks."""
        self._queue.add_scan(message, sensor)

    def on_transforms(self, transforms: Sequence[StampedTransform], *, static: bool = False) -> None:
        """Add transforms; never blocks."""
        self._queue.add_transforms(self._publisher.drop_own_transforms(transforms), static=static)

    def refuse_message(self, what: str, problem: str) -> None:
        """Report a message that the transport could not even decode."""
        self._warn(f"{what} refused", problem)

    def dynamic_map(self) -> GridMessage | None:
        """Return the last published map; None before the first one."""
        return self._known_map if self.localizes or self._renderer is None else self._renderer.latest

    def diagnostics(self) -> Diagnostics:
        """Return the diagnostics, which are also published once per second."""
        return self._publisher.diagnostics()

    def reset(self) -> None:
        """Reset the state, and restart with the next scan: with an empty map, or anywhere in the known one."""
        if self.localizes:
            self.set_pose(None)
        else:
            self._queue.end_session(SessionEnd.RESET)

    def set_pose(self, pose: InitialPose) -> None:
        """Set the pose (3,) of the robot in the known map and its covariance (3, 3); None: the pose is unknown.

        Raises ArgumentError if the node maps, the pose is not in the map, or the covariance is invalid.
        """
        if not isinstance(self.configuration, Localization):
            raise ArgumentError("pose", "a node that localizes", "one that maps")
        if pose is not None:  # validates it
            sample_gaussian(1, *pose, np.random.default_rng(0))
            self.configuration.known.require(pose[0])

        def apply() -> None:
            if isinstance(self._session, LocalizationSession):
                self._session.set_pose(pose)

        self._queue.post(apply)

    def _show_known_map(self, message: GridMessage) -> None:
        """Publish a map, stamped now: 0 as long as simulated time has not begun, and once more then."""
        self._known_map = message._replace(stamp_ns=self._outputs.now_ns())
        self._outputs.map(self._known_map)

    def pause(self, paused: bool) -> None:
        """Drop incoming scans, or accept them again."""
        self._queue.is_paused = paused

    @property
    def localizes(self) -> bool:
        """Whether the map is known."""
        return isinstance(self.configuration, Localization)

    def save(self, folder: str | Path, timeout_s: float = 60.0) -> dict[str, Any]:
        """Write the output files of `gridslam map`, and autosave the session; the filter waits while tables are copied.

        Returns the content of run.json. Raises GridslamError if nothing is mapped yet, OutputError if the folder
        cannot be written or the filter does not respond.
        """
        answer: Future[Session] = Future()

        def respond() -> None:
            try:
                answer.set_result(self._copy_mapped())
            except GridslamError as error:
                answer.set_exception(error)
            self._save_now()

        self._queue.post(respond)
        try:
            copied = answer.result(0.0 if self.ended.is_set() else timeout_s)
        except TimeoutError:
            raise OutputError(f"the filter did not respond within {timeout_s:g} s") from None
        return copied.save(folder)

    @property
    def mapped_session(self) -> Session | None:
        """The mapping session; None if nothing is mapped yet. For the filter's thread."""
        session = self._session
        return session if isinstance(session, Session) and session.state is not None else None

    def _copy_mapped(self, *, is_last: bool = False) -> Session:
        mapped = self.mapped_session
        if mapped is None:
            why = (
                "this node localizes; `gridslam localize` takes its record"
                if self.localizes
                else "there was no scan yet"
            )
            raise GridslamError(f"nothing is mapped: {why}")
        return mapped.copy(self._whole_record(), is_last=is_last, messages=self.messages.to_list())

    def _run_filter(self) -> None:
        """Run the sessions one after the other."""
        try:
            while self._run_session():
                self._end_session()
        except BaseException as error:  # report any error of the thread
            self.failure = error
            self._publisher.facts.failure = f"{type(error).__name__}: {error}"
            self._report_state(lambda call: call())
        finally:
            self.ended.set()

    def _end_session(self) -> None:
        """Give the session away and begin the next one; where it has no scan yet and nothing changes it is the next."""
        end = self._session_end
        is_begun = self._session.state is not None
        forgets = end is SessionEnd.RESET and isinstance(self._session, Session) and self._session.continued is not None
        if not is_begun and not forgets:
            return
        is_carried = end is SessionEnd.CARRIED
        if is_begun:
            if is_carried or (end is SessionEnd.JUMP and self._goes_on is not None):
                self._go_on_elsewhere()
            if self._renderer is not None:
                self._renderer.reset()
        self._begin_session()
        if is_begun and not is_carried:  # what is recorded is split by `gridslam map` where the node has
            self._close_record()
            with self._reporting("record"):
                self._begin_record()

    def _run_session(self) -> bool:
        """Map until the session ends; return whether another one follows."""
        source = self._measurements()
        for wrap in self._wrappers:
            source = wrap(source)
        first = next(source, None)
        if first is not None:
            observers = [
                isolate(self._publisher, partial(self._warn, "publishing failed")),
                *(isolate(observer, partial(self._warn, "viewer failed")) for observer in self._observers),
            ]
            self._session.run(chain([first], source), observers, self._report_failure)
        if self._session_end is SessionEnd.CLOSED:
            return False
        end, level = self._session_end, Level.OK  # which was asked for
        if end in _FOUND:
            level = Level.ERROR if end is SessionEnd.JUMP and not self.localizes else Level.WARN
        self.messages.report(level, f"{self._session.restart_message}: {end.value}")
        return True

    def _go_on_elsewhere(self) -> None:
        """Let the next drive belong to the same session."""
        mapped = self.mapped_session
        if mapped is None:
            return
        try:
            saved = mapped.to_session(wait=True)
        except GridslamError as error:
            self._warn("session", str(error))
            return
        if saved is not None:
            is_in_file = mapped.continued is not None and mapped.continued.is_in_file
            path = self._goes_on or self.results_folder / "session.gridslam"  # where it is saved if somebody asks
            self._continued = Continued(path, saved, is_elsewhere=True, is_in_file=is_in_file)
            if self._autosave is not None:
                self._autosave.note_continued()

    def _report_failure(self, failed: FailedStep) -> None:
        self._warn("scan failed", str(failed))

    def _measurements(self) -> Iterator[Measurement]:
        """Yield measurements as they arrive, and run posted calls between two of them.

        Where the view changes they are held back, ten of a laser at most, until it is certain whether the robot was
        carried.
        """
        while True:
            while self._certain:
                if self._certain[0][0] > self._drive:
                    self._drive = self._certain[0][0]
                    self._session_end = SessionEnd.CARRIED
                    return
                yield self._begin_step(self._certain.popleft()[1])
            item = self._queue.take()
            if isinstance(item, SessionEnd):
                for _, accepted in self._numbering.end():
                    yield self._begin_step(accepted)
                self._session_end = item
                return
            if isinstance(item, AcceptedScan):
                self._publisher.note_arrival(item)
                self._record_scan(item)
                self._certain.extend(self._number(item))
                continue
            with self._reporting("request failed"):
                item()

    def _number(self, accepted: AcceptedScan) -> list[tuple[int, AcceptedScan]]:
        """Return the scans whose drive is certain from this one on; without loop closure no robot is relocalized."""
        with self._reporting("checks failed"):
            if isinstance(self.configuration, Configuration) and self.configuration.loop_closure is not None:
                return self._numbering.take(accepted, accepted.measurement)
        return [*self._numbering.end(), (self._drive, accepted)]

    def _begin_step(self, accepted: AcceptedScan) -> Measurement:
        """Note a scan that the filter processes next, and warn of what the doctor finds where the session begins."""
        if isinstance(self._session, Session):
            self._session.add(accepted)
        with self._reporting("checks failed"):
            for finding in self._check.take(accepted.measurement):
                self._warn_of(finding)
        self._publisher.set_measurement(accepted)
        return accepted.measurement

    def _record_scan(self, accepted: AcceptedScan) -> None:
        """Add a scan to the record, which ends if that fails."""
        try:
            if self._recorder is not None:
                self._recorder.add(accepted)
        except Exception as error:
            self._close_record()
            self._warn("record", describe_error(error))

    @contextmanager
    def _reporting(self, kind: str) -> Iterator[None]:
        """Report an exception, and go on: only the filter itself may end the map."""
        try:
            yield
        except Exception as error:
            self._warn(kind, describe_error(error))

    def _warn_of(self, finding: Finding) -> None:
        self._warn(finding.code, f"{finding.message} {finding.remedy}".rstrip())

    def _publish_map(self) -> None:
        if self._session.state is not None and not self.localizes:
            self._publisher.publish_map(self._session.state)

    def _publish_diagnostics(self) -> None:
        known = self._known_map
        if known is not None and not known.stamp_ns and self._outputs.now_ns():
            self._show_known_map(known)
        self._report_state(self._queue.post)

    def _report_state(self, call: Callable[[Callable[[], None]], None]) -> None:
        """Log the state if it is new, publish it, and show it to viewers: `call` reaches the filter's thread."""
        self._publisher.log_state()
        diagnostics = self._publisher.diagnostics()
        self._outputs.diagnostics(diagnostics)
        for on_diagnostics in self._diagnostics_callbacks:
            call(partial(on_diagnostics, diagnostics))

    def _save_now(self, *, wait: bool = False) -> None:
        """Write the session; the filter waits while its tables are copied."""
        mapped = self.mapped_session
        if self._autosave is not None and mapped is not None:
            self._autosave.save(mapped, wait=wait)

    def _begin_session(self) -> None:
        self._publisher.start_session()
        self._check = EarlyCheck()
        if self._session_end is not SessionEnd.CARRIED:
            self._numbering = DriveNumbering[AcceptedScan](self._warn_of)
            self._drive = 0
        self._session: Session | LocalizationSession
        if isinstance(self.configuration, Localization):
            self._session = LocalizationSession(self.configuration, self.settings.seed)
            return
        seed = self.settings.seed if self._continued is None else self._continued.saved.seed
        log = self.messages.report
        self._session = Session(self.configuration, seed, self.settings.threads, self._continued, log)
        self._continued = None  # a later one begins with nothing

    def _begin_record(self) -> None:
        self._recorder = None
        if self._record is None:
            return
        self._recorder = ScanRecorder(self._record)
        if self._recorder.path != self._record:
            self.messages.report(Level.OK, f"{self._record} is an earlier record: recording to {self._recorder.path}")

    def _whole_record(self) -> Path | None:
        """The record of the session, if it contains all its scans."""
        return self._recorder.path if self._recorder is not None and self._recorder.is_whole else None

    def _close_record(self) -> None:
        if self._recorder is not None:
            self._recorder.close()

    def _run_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        while not self.ended.wait(period_s):
            with self._reporting("publishing failed"):
                callback()
