"""Pause, step and speed: a log is held back between two scans, and the filter never knows."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import final

from gridslam.errors import ArgumentError

__all__ = ["Control", "RobotControl", "check_particle", "check_speed"]

_MAX_WAIT_S = 0.25  # a wait is cut in pieces, so that signals and requests are seen


def check_speed(factor: float | None) -> float | None:
    """A speed that a viewer asks for; ArgumentError where it is out of range."""
    if factor is not None and not 0.01 <= factor <= 1e4:
        raise ArgumentError("factor", "0.01 to 10000, or null for as fast as can be", factor)
    return factor


def check_particle(particle: object, count: int) -> int:
    """An index of `count` particles that a viewer asks for; ArgumentError where it is none."""
    if not isinstance(particle, int) or not 0 <= particle < count:
        raise ArgumentError("particle", f"an index below {count}", particle)
    return particle


@final
class Control:
    """Decides when the next scan may go to the filter; viewers ask, the filter's thread waits.

    Parameters
    ----------
    speed : float or None, > 0
        So many times as fast as the robot drove; None for as fast as can be.
    """

    def __init__(self, speed: float | None = None) -> None:
        """Begin without a pause."""
        self._changed = threading.Condition()
        self._speed, self._paused, self._ended = speed, False, False
        self._steps, self._to_key_scan = 0, False
        self._anchor: tuple[float, int] | None = None  # a moment, and the stamp that belonged to it

    @property
    def paused(self) -> bool:
        """Whether the next scan has to wait for a viewer."""
        return self._paused

    @property
    def speed(self) -> float | None:
        """How many times as fast as the robot drove, at most; None without limit."""
        return self._speed

    def pause(self) -> None:
        """Hold the next scan."""
        self._change(paused=True)

    def resume(self) -> None:
        """Go on."""
        self._change(paused=False)

    def step(self, *, to_key_scan: bool) -> None:
        """Let one scan go, or all up to the next key scan, and pause then."""
        with self._changed:
            self._steps, self._to_key_scan = (0, True) if to_key_scan else (1, False)
        self._change(paused=True)

    def set_speed(self, speed: float | None) -> None:
        """Go so many times as fast as the robot drove; None for as fast as can be."""
        with self._changed:
            self._speed, self._anchor = speed, None
            self._changed.notify_all()

    def end(self) -> None:
        """Hold nothing from now on."""
        self._ended = True
        self._change(paused=False)
        self.set_speed(None)

    def wake(self) -> None:
        """Let a waiting filter's thread look after requests."""
        with self._changed:
            self._changed.notify_all()

    def on_key_scan(self) -> None:
        """A step that was to go to the next key scan is done."""
        self._to_key_scan = False

    def wait(self, stamp_ns: int, on_wait: Callable[[], None]) -> bool:
        """Return when the scan of this stamp may go, and whether that took a wait; meanwhile call `on_wait`."""
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

    def _change(self, *, paused: bool) -> None:
        with self._changed:
            self._paused = paused and not self._ended
            if not paused:
                self._steps, self._to_key_scan = 0, False
            self._anchor = None
            self._changed.notify_all()

    def _delay(self, stamp_ns: int) -> float:
        """Seconds for which the scan is to be held as things are."""
        if self._paused:
            if self._to_key_scan:
                return 0.0
            if self._steps:
                self._steps -= 1
                return 0.0
            return float("inf")
        if self._speed is None:
            return 0.0
        now = time.perf_counter()
        if self._anchor is None:
            self._anchor = now, stamp_ns
        passed = (stamp_ns - self._anchor[1]) * 1e-9 / self._speed
        due = self._anchor[0] + passed
        if passed < 0 or now - due > 1.0:  # stamps that go back, and a filter that is slower: nothing is made up for
            self._anchor = now, stamp_ns
            return 0.0
        return due - now


@final
class RobotControl:
    """In the place of `Control` where a robot drives: its scans can be left out, but not held back.

    Parameters
    ----------
    is_paused : callable
        Tells whether scans are left out.
    pause : callable
        Has them left out, or not.
    """

    speed = None

    def __init__(self, is_paused: Callable[[], bool], pause: Callable[[bool], None]) -> None:
        self._is_paused, self._pause = is_paused, pause

    @property
    def paused(self) -> bool:
        """Whether scans are left out."""
        return self._is_paused()

    def pause(self) -> None:
        """Leave out the scans that come."""
        self._pause(True)

    def resume(self) -> None:
        """Take scans again."""
        self._pause(False)

    def step(self, *, to_key_scan: bool) -> None:
        """Raise ArgumentError."""
        raise ArgumentError("do", "pause or resume, as a robot drives on", "step")

    def set_speed(self, speed: float | None) -> None:
        """Raise ArgumentError."""
        raise ArgumentError("do", "pause or resume, as a robot drives on", "speed")

    def end(self) -> None:
        """Leave things as they are."""

    def wake(self) -> None:
        """Wake nobody: nothing waits."""

    def on_key_scan(self) -> None:
        """Go on."""

    def wait(self, stamp_ns: int, on_wait: Callable[[], None]) -> bool:
        """Return at once."""
        return False
