"""Pause, step and speed: delays the log between two scans, transparently to the filter."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import final

from gridslam.errors import ArgumentError

_MAX_WAIT_S = 0.25  # longer waits are split, so that signals and requests are processed


def check_speed(factor: float | None) -> float | None:
    """Check a speed requested by a viewer; raises ArgumentError if it is out of range."""
    if factor is not None and not 0.01 <= factor <= 1e4:
        raise ArgumentError("factor", "0.01 to 10000, or null for as fast as can be", factor)
    return factor


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
