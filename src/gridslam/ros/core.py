"""The node, without any transport: messages in, messages out, and the one loop of `gridslam.pipeline` between them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias, final

import numpy as np

from gridslam.config import Configuration
from gridslam.errors import ArgumentError, ConfigurationError, OutputError
from gridslam.io.measurement import Measurement
from gridslam.particles import sample_gaussian
from gridslam.pipeline import Observer
from gridslam.ros.accepted import Accepted
from gridslam.ros.complaints import Complaints
from gridslam.ros.intake import Intake, Turn
from gridslam.ros.localization import KnownMapTeller, Localization, LocalizationSession, Place
from gridslam.ros.messages import Diagnostics, GridMessage, Level, Outputs, ScanMessage, StampedTransform
from gridslam.ros.rendering import MapRenderer
from gridslam.ros.session import Session, TakenSession
from gridslam.ros.settings import NodeSettings
from gridslam.ros.speaker import Speaker
from gridslam.slam.odometry_tracker import OdometryTracker

__all__ = ["Gate", "NodeCore"]

Gate: TypeAlias = Callable[[Iterator[Measurement]], Iterator[Measurement]]

_DIAGNOSTICS_S = 1.0


@final
class NodeCore:
    """Maps a live lidar stream.

    Callbacks never wait for the filter. A session begins with a first scan; it ends, and the next one begins with
    a new map, at a reset and where time jumps back and the robot is elsewhere, as when a bag is played again.

    Parameters
    ----------
    settings : NodeSettings
        Frames, rates and bounds.
    configuration : Configuration or Localization
        Of the filter; the second where the map is known.
    outputs : Outputs
        The transport.
    record : str or Path, optional
        CSV of the accepted scans, which `gridslam map` maps with identical results; later sessions get `-2`, `-3`, ...
        before its suffix.
    observers : sequence of Observer
        Called after each scan, in the filter's thread.

    Attributes
    ----------
    failure : BaseException or None
        What ended the filter's thread, if it was no `close`.
    ended : threading.Event
        Set when the filter's thread has ended.

    Raises
    ------
    ConfigurationError
        The filter needs odometry, and the settings allow it to be missing.
    OutputError
        Nothing can be written where the record should be.
    """

    def __init__(
        self,
        settings: NodeSettings,
        configuration: Configuration | Localization,
        outputs: Outputs,
        *,
        record: str | Path | None = None,
        observers: Sequence[Observer] = (),
    ) -> None:
        by_odometry = isinstance(configuration, Localization) or isinstance(configuration.tracker, OdometryTracker)
        if settings.odometry != "needed" and by_odometry:
            expected = "expected needed, as this filter requires it"
            raise ConfigurationError(f"odometry: {expected}, got {settings.odometry}")
        self.settings, self.configuration = settings, configuration
        self.failure: BaseException | None = None
        self.ended = threading.Event()
        self._outputs, self._observers = outputs, list(observers)
        self._gates: list[Gate] = []
        self._hearers: list[Callable[[Diagnostics], None]] = []
        self._record = None if record is None else Path(record)
        self._complain = Complaints(outputs.say)
        self._intake = Intake(settings, self._complain)
        self._renderer = _renderer(configuration, settings, outputs)
        self._speaker = Speaker(settings, outputs, self._renderer, self._intake, self._complain)
        self._session = self._new_session()
        self._turns: list[Turn] = []
        clocks = [("transform", settings.transform_publish_period_s, self._speaker.tell_transform)]
        clocks += [("diagnostics", _DIAGNOSTICS_S, self._tell_diagnostics)]
        clocks += [("map", settings.map_update_interval_s, lambda: self._intake.post(self._draw))]
        self._threads = [threading.Thread(target=self._filter, name="gridslam-filter", daemon=True)]
        self._threads += [
            threading.Thread(target=self._every, args=(period_s, tell), name=f"gridslam-{name}", daemon=True)
            for name, period_s, tell in clocks
            if period_s
        ]

    def watch(
        self, observer: Observer, gate: Gate = iter, hear: Callable[[Diagnostics], None] = lambda told: None
    ) -> None:
        """Let someone look on; to be called before `start`.

        `observer` is called after each scan, `gate` gets the measurements of each session and yields them, and `hear`
        gets the diagnostics once per second; all in the filter's thread.
        """
        self._observers.append(observer)
        self._gates.append(gate)
        self._hearers.append(hear)

    def start(self) -> None:
        """Begin to take messages."""
        self._renderer.begin(self._outputs.now_ns())
        for thread in self._threads:
            thread.start()

    def close(self) -> TakenSession | None:
        """End, and give what there is to be saved; None where no scan was mapped."""
        self._intake.turn(Turn.CLOSED)
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        self._renderer.close()
        session = self._session
        taken = session.taken() if isinstance(session, Session) and session.state is not None else None
        session.close()
        return taken

    def on_scan(self, message: ScanMessage, sensor: str = "scan") -> None:
        """Take a scan of the topic `sensor`; returns at once."""
        self._intake.add_scan(message, sensor)

    def on_transforms(
        self, transforms: Sequence[StampedTransform], *, static: bool = False, publisher: str = ""
    ) -> None:
        """Take transforms, where it is known of whom; returns at once."""
        self._intake.add_transforms(self._speaker.others(transforms, publisher), static=static, publisher=publisher)

    def refuse(self, what: str, problem: str) -> None:
        """Report a message that the transport could not even decode."""
        self._complain(f"{what} refused", problem)

    def dynamic_map(self) -> GridMessage | None:
        """Give the map that was published last; None before the first one."""
        return self._renderer.latest

    def diagnostics(self) -> Diagnostics:
        """Return the diagnostics, which are also published once per second."""
        return self._speaker.diagnostics()

    def reset(self) -> None:
        """Reset the state, and restart with the next scan: with an empty map, or anywhere in the known one."""
        if self.localizes:
            self.place(None)
        else:
            self._intake.turn(Turn.RESET)

    def place(self, place: Place) -> None:
        """Let the robot be at a pose (3,) with a covariance (3, 3) in the known map; nowhere known, if None.

        Raises ArgumentError where no map is known, and for what is no pose in the map, or no covariance.
        """
        if not isinstance(self.configuration, Localization):
            raise ArgumentError("place", "a node that localizes", "one that maps")
        if place is not None:  # validates it
            sample_gaussian(1, *place, np.random.default_rng(0))
            self.configuration.known.require(place[0])

        def put() -> None:
            assert isinstance(self._session, LocalizationSession)
            self._session.place(place)

        self._intake.post(put)

    def pause(self, paused: bool) -> None:
        """Leave out the scans that come from now on, or take them again."""
        self._intake.is_paused = paused

    @property
    def localizes(self) -> bool:
        """Whether the map is known."""
        return isinstance(self.configuration, Localization)

    @property
    def is_paused(self) -> bool:
        """Whether scans are left out."""
        return self._intake.is_paused

    def save(self, folder: str | Path, timeout_s: float = 60.0) -> dict[str, Any]:
        """Write what `gridslam map` writes; the filter waits only while its state is copied.

        Returns the content of run.json. Raises ArgumentError if nothing is mapped yet, OutputError if the folder
        cannot be written or the filter does not answer.
        """
        answer: list[TakenSession | ArgumentError | OutputError | None] = []
        done = threading.Event()

        def take() -> None:
            try:
                answer.append(self._session.taken())
            except (ArgumentError, OutputError) as error:
                answer.append(error)
            done.set()

        self._intake.post(take)
        if self.ended.is_set() or not done.wait(timeout_s):
            raise OutputError(f"{folder}: the filter did not answer within {timeout_s:g} s")
        (taken,) = answer
        if not isinstance(taken, TakenSession):
            raise taken or OutputError(f"{folder}: nothing to save")
        return taken.save(folder)

    def _filter(self) -> None:
        """Run session after session."""
        try:
            while self._run_session():
                if self._session.state is not None:
                    self._session.close()
                    self._renderer.forget()
                    self._session = self._new_session()
        except BaseException as error:  # the thread must not end unheard
            self.failure = error
            self._outputs.say(Level.ERROR, f"the filter has ended: {type(error).__name__}: {error}")
        finally:
            self.ended.set()

    def _run_session(self) -> bool:
        """Map until the session ends; return whether another one follows."""
        session, why = self._session, self._turns
        why.clear()
        source = self._measurements(session)
        for gate in self._gates:
            source = gate(source)
        first = next(source, None)
        if first is not None:
            session.run(chain([first], source), [self._speaker, *self._observers])
        if why[-1] is not Turn.CLOSED:
            self._outputs.say(Level.WARN, f"{session.begins}: {why[-1].value}")
        return why[-1] is not Turn.CLOSED

    def _measurements(self, session: Session | LocalizationSession) -> Iterator[Measurement]:
        """Yield measurements as they come; what was posted is done between two of them."""
        while True:
            taken = self._intake.take()
            if isinstance(taken, Accepted):
                try:
                    session.add(taken)
                except OutputError as error:
                    self._complain("record", str(error))
                self._speaker.hears(taken)
                yield taken.measurement
            elif isinstance(taken, Turn):
                self._turns.append(taken)
                return
            else:
                taken()

    def _draw(self) -> None:
        if self._session.state is not None:
            self._speaker.draw(self._session.state)

    def _tell_diagnostics(self) -> None:
        told = self._speaker.diagnostics()
        self._outputs.diagnostics(told)
        self._speaker.tell_state()
        for hear in self._hearers:
            self._intake.post(partial(hear, told))

    def _new_session(self) -> Session | LocalizationSession:
        self._speaker.begin()
        number, record = self._speaker.sessions, self._record
        if record is not None and number > 1:
            record = record.with_name(f"{record.stem}-{number}{record.suffix}")
        config, settings = self.configuration, self.settings
        if isinstance(config, Localization):
            return LocalizationSession(config, settings.seed, record)
        return Session(config, settings.seed, settings.threads, record)

    def _every(self, period_s: float, tell: Callable[[], None]) -> None:
        while not self.ended.wait(period_s):
            tell()


def _renderer(
    configuration: Configuration | Localization, settings: NodeSettings, outputs: Outputs
) -> MapRenderer | KnownMapTeller:
    if isinstance(configuration, Localization):
        return KnownMapTeller(configuration, settings.map_values, settings.map_frame, outputs.map)
    return MapRenderer(configuration.mapper, settings.map_values, settings.map_frame, outputs.map)
