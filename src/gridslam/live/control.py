"""Pause, step and speed: delays the log between two scans, transparently to the filter."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np

from gridslam.errors import ArgumentError, GridslamError
from gridslam.types import FloatArray

_POSE_COVARIANCE = np.diag([0.25, 0.25, (math.pi / 12) ** 2])  # of a pose set by hand, as RViz sends it, m^2 and rad^2
LOCATING = "the robot is being located"
_SLOW = {  # commands that take long: what is answered at once, and in the end
    "save": ("saving", "saved"),
    "serialize": ("saving the session", "done"),
    "go_on": ("reading the session", "continued"),
}
_MAX_WAIT_S = 0.25  # longer waits are split, so that signals and requests are processed


def check_speed(factor: float | None) -> float | None:
    """Check a speed requested by a viewer; raises ArgumentError if it is out of range."""
    if factor is not None and not 0.01 <= factor <= 1e4:
        raise ArgumentError("factor", "0.01 to 10000, or null for as fast as can be", factor)
    return factor


def check_particle(particle: object, count: int) -> int:
    """Check a particle's index requested by a viewer; raises ArgumentError if it is not below `count`."""
    if not isinstance(particle, int) or not 0 <= particle < count:
        raise ArgumentError("particle", f"an index below {count}", particle)
    return particle


@final
class Control:
    """Decides when the next scan is passed to the filter; viewers set it, the filter's thread waits.

    Parameters
    ----------
    speed : float or None, > 0
        Factor on real time; None: as fast as possible.

    Attributes
    ----------
    speed : float or None
        Maximum factor on real time, see `set_speed`.
    paused : bool
        Whether the run is paused.
    """

    def __init__(self, speed: float | None = None) -> None:
        """Start without a pause."""
        self.speed = speed
        self.paused = False
        self._changed = threading.Condition()
        self._ended = False
        self._steps = 0.0  # scans to pass during a pause; infinite up to the next key scan
        self._anchor: tuple[float, int] | None = None  # a time and the corresponding stamp

    def pause(self) -> None:
        """Pause before the next scan."""
        self._change(paused=True)

    def resume(self) -> None:
        """End the pause."""
        self._change(paused=False)

    def step(self, *, to_key_scan: bool) -> None:
        """Pass one scan, or all up to the next key scan, then pause."""
        self._change(paused=True, steps=math.inf if to_key_scan else 1)

    def set_speed(self, speed: float | None) -> None:
        """Set the speed as a multiple of real time; None for maximum speed."""
        with self._changed:
            self.speed = speed
            self._anchor = None
            self._changed.notify_all()

    def end(self) -> None:
        """Stop delaying scans."""
        self._ended = True
        self.resume()
        self.set_speed(None)

    def wake(self) -> None:
        """Wake a waiting filter's thread to process requests."""
        with self._changed:
            self._changed.notify_all()

    def on_key_scan(self) -> None:
        """End a step to the next key scan."""
        if self._steps == math.inf:
            self._steps = 0

    def wait(self, stamp_ns: int, on_wait: Callable[[], None]) -> bool:
        """Wait until the scan of this stamp may be processed, calling `on_wait`; return whether that took a wait."""
        waited = False
        while True:
            with self._changed:
                delay = self._delay(stamp_ns)
                if delay <= 0:
                    return waited
                if waited:
                    self._changed.wait(min(delay, _MAX_WAIT_S))
            on_wait()
            waited = True

    def _change(self, *, paused: bool, steps: float = 0) -> None:
        with self._changed:
            self.paused = paused and not self._ended
            self._steps = steps
            self._anchor = None
            self._changed.notify_all()

    def _delay(self, stamp_ns: int) -> float:
        """Return the remaining delay of the scan, s."""
        if self.paused:
            if not self._steps:
                return math.inf
            self._steps -= 1
            return 0.0
        if self.speed is None:
            return 0.0
        now = time.perf_counter()
        if self._anchor is None:
            self._anchor = now, stamp_ns
        passed = (stamp_ns - self._anchor[1]) * 1e-9 / self.speed
        due = self._anchor[0] + passed
        if passed < 0 or now - due > 1.0:  # decreasing stamps, or a slower filter: restart the clock
            self._anchor = now, stamp_ns
            return 0.0
        return due - now


@final
class RobotCommands(NamedTuple):
    """Commands of viewers to a robot's filter; None for each that it does not offer.

    Attributes
    ----------
    set_pose : callable, optional
        Called with a pose (3,), x m, y m, theta rad, and its covariance (3, 3).
    locate : callable, optional
        Makes the pose unknown: the robot is located anywhere in the known map.
    reset : callable, optional
        Starts again, with an empty map.
    save, serialize, go_on : callable, optional
        Called with the name of a session, empty for the usual one, they write the results or the session, or continue
        that one. They return whether they succeeded, and a message; they may take long, and run in a thread of their
        own.
    """

    set_pose: Callable[[tuple[FloatArray, FloatArray]], None] | None = None
    locate: Callable[[], None] | None = None
    reset: Callable[[], None] | None = None
    save: Callable[[str], tuple[bool, str]] | None = None
    serialize: Callable[[str], tuple[bool, str]] | None = None
    go_on: Callable[[str], tuple[bool, str]] | None = None

    @property
    def names(self) -> list[str]:
        """Names of those that are offered."""
        return [name for name, command in self._asdict().items() if command is not None]


NO_COMMANDS = RobotCommands()
"""Nothing that viewers may do."""


@final
class RobotControl:
    """Control of a live robot by viewers: scans can be dropped but not delayed.

    Parameters
    ----------
    is_paused : callable
        Returns whether scans are left out.
    pause : callable
        Sets whether scans are dropped.
    commands : RobotCommands, optional
        What else viewers may do; by default nothing.
    """

    speed = None

    def __init__(
        self,
        is_paused: Callable[[], bool],
        pause: Callable[[bool], None],
        commands: RobotCommands = NO_COMMANDS,
    ) -> None:
        self._is_paused = is_paused
        self._pause = pause
        self.commands = commands
        self._at_work = threading.Lock()

    def execute(self, command: Mapping[str, Any], answer: Callable[[str], None]) -> None:
        """Execute a viewer's command; `answer` receives the outcome, also from another thread.

        Raises ArgumentError, KeyError, TypeError or ValueError if this is no command that is offered.
        """
        name = command["command"]
        if name not in self.commands.names:
            raise ArgumentError("command", f"one of {', '.join(self.commands.names) or 'none'}", name)
        if name in _SLOW:
            self._start(name, command.get("session", ""), answer)
            return
        try:
            if name == "set_pose" and self.commands.set_pose is not None:
                x, y, theta = (float(value) for value in command["pose"])
                if not math.isfinite(x + y + theta):
                    raise ArgumentError("pose", "finite numbers", command["pose"])
                self.commands.set_pose((np.array([x, y, theta]), _POSE_COVARIANCE))
                answer(f"pose set to {x:.2f} m, {y:.2f} m, {math.degrees(theta):.0f}°")
            elif name == "locate" and self.commands.locate is not None:
                self.commands.locate()
                answer(LOCATING)
            elif self.commands.reset is not None:
                self.commands.reset()
                answer("reset: the next scan begins a new map")
        except GridslamError as error:
            answer(str(error))

    def _start(self, name: str, session: object, answer: Callable[[str], None]) -> None:
        """Execute a command that takes long in a thread, one at a time."""
        doing, done = _SLOW[name]
        if not isinstance(session, str) or session != Path(session).name:
            answer(f"not {done}: expected the name of a session in the node's folder, got {session!r:.60}")
            return
        if not self._at_work.acquire(blocking=False):
            answer("still at work on the command before")
            return

        def run() -> None:
            try:
                succeeded, message = getattr(self.commands, name)(session)
                answer(f"{done if succeeded else f'not {done}'}: {message}")
            except Exception as error:
                answer(f"not {done}: {error}")
            finally:
                self._at_work.release()

        answer(doing)
        threading.Thread(target=run, name=f"gridslam-{name}", daemon=True).start()

    @property
    def paused(self) -> bool:
        """Whether scans are dropped."""
        return self._is_paused()

    def pause(self) -> None:
        """Drop incoming scans."""
        self._pause(True)

    def resume(self) -> None:
        """Accept scans again."""
        self._pause(False)

    def step(self, *, to_key_scan: bool) -> None:
        """Raise ArgumentError."""
        raise ArgumentError("do", "pause or resume, as a robot drives on", "step")

    def set_speed(self, speed: float | None) -> None:
        """Raise ArgumentError."""
        raise ArgumentError("do", "pause or resume, as a robot drives on", "speed")
