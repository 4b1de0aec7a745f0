"""The page of a finished run, read from its folder: each viewer has its own time line."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.live.control import check_particle, check_speed
from gridslam.live.finished import open_finished_run
from gridslam.live.options import LiveOptions
from gridslam.live.results import ReplayFrame
from gridslam.live.scene import NO_POINTS, RobotPath, Scene, SentState
from gridslam.live.server import PageServer
from gridslam.live.tiles import TileReplica
from gridslam.types import OccupancyGrid

__all__ = ["Replay", "ReplayPage", "ReplayViewer"]


@final
class Replay:
    """The results of a finished run, as content of the page.

    Parameters
    ----------
    folder : str or Path
        OUT of the run.

    Raises
    ------
    InputError
        The folder contains no results, or they are malformed (see `open_finished_run`).
    """

    def __init__(self, folder: str | Path) -> None:
        """Read the folder."""
        self.results, self.run_info, self.missing = open_finished_run(folder)
        self.replica = TileReplica() if self.results.grid is None else TileReplica.of(self.results.grid)

    def add_viewer(self, notify: Callable[[], None]) -> ReplayViewer:
        """Add a viewer at the end of the run; `notify` is never called, as the content does not change."""
        return ReplayViewer(self)

    def channel_map(self, channel: int) -> OccupancyGrid | None:
        """Return the map, which all channels share."""
        return self.results.grid


@final
class ReplayViewer:
    """A viewer of a finished run, with its own time."""

    def __init__(self, replay: Replay) -> None:
        """Start at the end."""
        self._replay, self._results, self._sent = replay, replay.results, SentState()
        self._last = len(self._results.times_s) - 1
        self._at, self._time_s = self._last, float(self._results.times_s[-1])
        self._speed, self._played_until = 10.0, 0.0
        self._playing = False
        self._selected: int | None = None
        self._frame: tuple[int, ReplayFrame] | None = None

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""
        if self._playing:
            self._play()
        return self._sent.next_message(self._scene())

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command; raises ArgumentError, KeyError, TypeError or ValueError if it is invalid."""
        what = command["do"]
        if what == "pause":
            self._playing = False
        elif what == "resume":
            if self._at == self._last:
                self._seek(0)
            self._playing, self._played_until = True, time.perf_counter()
        elif what == "step":
            self._playing = False
            self._seek(min(self._at + 1, self._last))
        elif what == "seek":
            self._seek(min(max(int(command["at"]), 0), self._last))
        elif what == "speed":
            self._speed = check_speed(command["factor"]) or self._speed
        elif what == "select":
            self._select(command["particle"])
        else:
            raise ArgumentError("do", "pause, resume, step, seek, speed or select", what)

    def close(self) -> None:
        """Do nothing: the replay keeps no list of viewers."""

    def _play(self) -> None:
        now = time.perf_counter()
        self._time_s += (now - self._played_until) * self._speed
        self._played_until = now
        times = self._results.times_s
        self._playing = self._time_s < times[-1]
        self._time_s = min(self._time_s, float(times[-1]))
        self._move_to(max(int(np.searchsorted(times, self._time_s, "right")) - 1, 0))

    def _seek(self, at: int) -> None:
        self._time_s, self._played_until = float(self._results.times_s[at]), time.perf_counter()
        self._move_to(at)

    def _move_to(self, at: int) -> None:
        if self._selected is not None:
            self._selected = self._results.find_relative(self._selected, self._at, at)
        self._at = at

    def _select(self, particle: int | None) -> None:
        self._selected = None if particle is None else check_particle(particle, self._results.particles)

    def _scene(self) -> Scene:
        """Return the current scene; unchanged parts are the same objects as before."""
        results, frame = self._results, self._current_frame()
        status = {
            **results.status(self._at, self._time_s), "at": self._at, "last": self._last, "time_s": self._time_s,
            "total_s": float(results.times_s[-1]), "stage": "running" if self._playing else "paused",
            "speed": self._speed, "selected_particle": self._selected, "message": self._replay.missing,
        }  # fmt: skip
        return Scene(
            self._replay.run_info, status, self._replay.replica, RobotPath(frame.path), frame.tree, frame.particles,
            NO_POINTS, frame.closures, results.series, results.path, results.landmarks,
        )  # fmt: skip

    def _current_frame(self) -> ReplayFrame:
        if self._frame is None or self._frame[0] != self._at:
            self._frame = self._at, self._results.frame(self._at)
        return self._frame[1]


@final
class ReplayPage:
    """Serves the page of a finished run while its context is entered; the constructor reads the run (InputError).

    Attributes
    ----------
    missing : str
        A message about missing files of the run; empty if nothing is missing.
    """

    def __init__(self, folder: str | Path, options: LiveOptions | None = None) -> None:
        """Read the run without serving it."""
        replay = Replay(folder)
        self.missing = replay.missing
        self._server = PageServer(replay, options or LiveOptions())

    def __enter__(self) -> ReplayPage:
        """Serve; raises OutputError if the port is in use."""
        self._server.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the page."""
        self._server.__exit__()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._server.url
