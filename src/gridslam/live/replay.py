"""A finished run, shown again from its folder, with a time line: each viewer looks at a time of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.live.control import checked_particle, checked_speed
from gridslam.live.finished import open_finished
from gridslam.live.options import LiveOptions
from gridslam.live.results import Moment
from gridslam.live.scene import NO_POINTS, Scene, Sent, Way
from gridslam.live.server import PageServer
from gridslam.live.tiles import TileMirror
from gridslam.types import OccupancyGrid

__all__ = ["Replay", "ReplayPage", "ReplayViewer"]


@final
class Replay:
    """The results of a finished run, as a show.

    Parameters
    ----------
    folder : str or Path
        OUT of the run.

    Raises
    ------
    InputError
        It holds no results, or these are malformed (see `open_finished`).
    """

    def __init__(self, folder: str | Path) -> None:
        """Read the folder."""
        self.results, self.hello, self.lacks = open_finished(folder)
        self.mirror = TileMirror() if self.results.grid is None else TileMirror.of(self.results.grid)

    def join(self, news: Callable[[], None]) -> ReplayViewer:
        """Take in a viewer, who looks at the end of the run; `news` is never called: nothing happens here."""
        return ReplayViewer(self)

    def map_of(self, channel: int) -> OccupancyGrid | None:
        """The map, whatever the channel."""
        return self.results.grid


@final
class ReplayViewer:
    """One who looks at a finished run, at a time of its own."""

    def __init__(self, replay: Replay) -> None:
        """Look at the end."""
        self._replay, self._results, self._sent = replay, replay.results, Sent()
        self._last = len(self._results.times_s) - 1
        self._at, self._time_s = self._last, float(self._results.times_s[-1])
        self._speed, self._since = 10.0, 0.0
        self._playing = False
        self._watched: int | None = None
        self._seen: tuple[int, Moment] | None = None

    def message(self) -> bytes | None:
        """What the viewer lacks; None where that is nothing."""
        if self._playing:
            self._play()
        return self._sent.message(self._scene())

    def command(self, command: Mapping[str, Any]) -> None:
        """Do what the viewer asks; raises ArgumentError, KeyError, TypeError or ValueError where it cannot be done."""
        what = command["do"]
        if what == "pause":
            self._playing = False
        elif what == "resume":
            if self._at == self._last:
                self._go(0)
            self._playing, self._since = True, time.perf_counter()
        elif what == "step":
            self._playing = False
            self._go(min(self._at + 1, self._last))
        elif what == "seek":
            self._go(min(max(int(command["at"]), 0), self._last))
        elif what == "speed":
            self._speed = checked_speed(command["times"]) or self._speed
        elif what == "watch":
            self._watch(command["particle"])
        else:
            raise ArgumentError("do", "pause, resume, step, seek, speed or watch", what)

    def close(self) -> None:
        """Look no more."""

    def _play(self) -> None:
        now = time.perf_counter()
        self._time_s += (now - self._since) * self._speed
        self._since = now
        times = self._results.times_s
        self._playing = self._time_s < times[-1]
        self._time_s = min(self._time_s, float(times[-1]))
        self._follow(max(int(np.searchsorted(times, self._time_s, "right")) - 1, 0))

    def _go(self, at: int) -> None:
        self._time_s, self._since = float(self._results.times_s[at]), time.perf_counter()
        self._follow(at)

    def _follow(self, at: int) -> None:
        if self._watched is not None:
            self._watched = self._results.relative(self._watched, self._at, at)
        self._at = at

    def _watch(self, particle: int | None) -> None:
        self._watched = None if particle is None else checked_particle(particle, self._results.particles)

    def _scene(self) -> Scene:
        """The scene now; what is as in the one before stays the same object."""
        results, moment = self._results, self._moment()
        status = {
            **results.facts(self._at, self._time_s), "at": self._at, "last": self._last, "time_s": self._time_s,
            "total_s": float(results.times_s[-1]), "stage": "running" if self._playing else "paused",
            "speed": self._speed, "watched": self._watched, "says": self._replay.lacks,
        }  # fmt: skip
        return Scene(
            self._replay.hello, status, self._replay.mirror, Way(moment.way), moment.tree, moment.particles, NO_POINTS,
            moment.closures, results.series, results.way, results.landmarks,
        )  # fmt: skip

    def _moment(self) -> Moment:
        if self._seen is None or self._seen[0] != self._at:
            self._seen = self._at, self._results.moment(self._at)
        return self._seen[1]


@final
class ReplayPage:
    """Serves the page of a finished run while its context is entered; reads the run at once (InputError).

    Attributes
    ----------
    lacks : str
        What of the run is no more there; empty where nothing is missing.
    """

    def __init__(self, folder: str | Path, options: LiveOptions | None = None) -> None:
        """Serve nothing yet."""
        replay = Replay(folder)
        self.lacks = replay.lacks
        self._server = PageServer(replay, options or LiveOptions())

    def __enter__(self) -> ReplayPage:
        """Serve; raises OutputError where the port is taken."""
        self._server.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the page."""
        self._server.__exit__()

    @property
    def url(self) -> str:
        """What to open in a browser."""
        return self._server.url
