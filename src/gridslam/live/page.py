"""The page of a running filter."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, final

from gridslam.errors import InputError
from gridslam.live.observer import LiveObserver
from gridslam.live.options import LiveOptions
from gridslam.live.recorder import Measured, RunRecorder
from gridslam.live.replay import Replay
from gridslam.live.run import LiveRun
from gridslam.live.server import PageServer
from gridslam.pipeline import Stopwatch
from gridslam.types import FloatArray, OccupancyGrid

_RECONNECT_S = 3.0


@final
class LivePage:
    """Serves the page of one run while its context is entered.

    Pass `observer` to `gridslam.pipeline.run` (or to a localization), and `pace(source)` as its source, or
    `follow(source)` for each session of a robot. The page never changes the filter's result.

    Parameters
    ----------
    title : str
        Title of the page.
    options : LiveOptions
        Address of the page.
    range_max_m : float, m
        Maximum range of the filter; farther beams are not displayed.
    known : OccupancyGrid, optional
        The known map of a filter that localizes.
    keeps_moments : bool
        Whether the history of the observer's recorder gets moments, to be written to `history.npz`.

    Attributes
    ----------
    observer : LiveObserver
        Observer to pass to the pipeline.
    """

    def __init__(
        self,
        title: str,
        options: LiveOptions | None = None,
        *,
        range_max_m: float = math.inf,
        known: OccupancyGrid | None = None,
        keeps_moments: bool = False,
    ) -> None:
        """Create the page without serving it."""
        options = options or LiveOptions()
        self._run = LiveRun(title, known)
        self._server = PageServer(self._run, options)
        self._last_stage = "final refinement" if known is None else "writing"
        recorder = RunRecorder(range_max_m, keeps_moments=keeps_moments)
        self.observer = LiveObserver(self._run.show, recorder, options.speed)
        self._run.observer = self.observer

    def __enter__(self) -> LivePage:
        """Serve; raises ConfigurationError if the port is in use."""
        self._server.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        """Close the page."""
        self._server.__exit__()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._server.url

    @property
    def viewers(self) -> int:
        """Number of viewers."""
        return len(self._run.viewers)

    def pace(self, source: Iterable[Measured], stopwatch: Stopwatch | None = None) -> Iterator[Measured]:
        """Do as `follow`, and show then that the run goes over to its next stage."""
        yield from self.follow(source, stopwatch)
        self._run.stage = self._last_stage

    def follow(self, source: Iterable[Measured], stopwatch: Stopwatch | None = None) -> Iterator[Measured]:
        """Reset the page, and yield the measurements of a session at the speed of the options at most.

        The stopwatch does not count the waiting time.
        """
        self._run.reset()
        return self.observer.pace(source, stopwatch)

    def show_messages(self, messages: Sequence[Mapping[str, Any]]) -> None:
        """Show the messages so far, the newest first (`gridslam.messages.Messages.to_list`)."""
        self._run.messages = messages

    def show_state(self, name: str, text: str) -> None:
        """Update the page while no scan arrives, and show a node's state; call from the filter's thread."""
        self.observer.show_pending()
        self._run.state = name, text

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Show the final result: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        self._run.finish(grid, poses, closures)

    def wait_for_viewer(self, timeout_s: float) -> bool:
        """Wait for a viewer, at most `timeout_s`; return whether there is one."""
        until = time.perf_counter() + timeout_s
        while not self.viewers and time.perf_counter() < until:
            time.sleep(0.05)
        return bool(self.viewers)

    def serve_until_left(self, folder: Path | None = None) -> None:
        """Show that the run is finished, and serve its replay as long as a viewer is connected.

        A lost connection has some seconds to reconnect.
        """
        self._run.stage = "finished"
        if folder is not None:
            with suppress(InputError):  # something else has changed the folder
                self._run.replay = Replay(folder)
        alone_since = -math.inf if not self.viewers else time.perf_counter()
        while time.perf_counter() - alone_since < _RECONNECT_S:
            time.sleep(0.1)
            if self.viewers:
                alone_since = time.perf_counter()
