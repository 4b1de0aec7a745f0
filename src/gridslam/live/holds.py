"""Who holds a run up: a viewer's pause and speed end with it."""

from __future__ import annotations

from typing import final

from gridslam.live.control import Control


@final
class Holds:
    """The viewers who hold a run up; used by the thread of the page's content only.

    Parameters
    ----------
    control : Control
        What they hold; its speed at first is that of nobody.
    """

    def __init__(self, control: Control) -> None:
        """Start without a viewer."""
        self._control = control
        self._initial_speed = control.speed
        self._holders: set[object] = set()
        self._speed_setter: object = None

    def pause(self, viewer: object) -> None:
        """Pause until a viewer resumes, or all who paused are gone; pauses of other viewers remain."""
        self._add(viewer)
        self._control.pause()

    def step(self, viewer: object, *, to_key_scan: bool) -> None:
        """Pass one scan, or all up to the next key scan, then pause as `pause` does."""
        self._add(viewer)
        self._control.step(to_key_scan=to_key_scan)

    def resume(self) -> None:
        """End all pauses."""
        self._holders.clear()
        self._control.resume()

    def set_speed(self, viewer: object, speed: float | None) -> None:
        """Set the speed until another viewer sets it, or this one is gone."""
        self._control.set_speed(speed)
        self._speed_setter = viewer

    def release(self, viewer: object) -> None:
        """End the pause and the speed of a viewer that is gone."""
        if viewer in self._holders:
            self._holders.remove(viewer)
            if not self._holders:
                self._control.resume()
        if viewer is self._speed_setter:
            self._speed_setter = None
            self._control.set_speed(self._initial_speed)

    def _add(self, viewer: object) -> None:
        if self._holders or not self._control.paused:
            self._holders.add(viewer)
