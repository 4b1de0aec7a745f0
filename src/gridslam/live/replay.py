"""The page of a finished run, read from the folder of its command: each viewer has its own time line."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.io.text import stay_below
from gridslam.live.ancestry_tree import NO_POINTS
from gridslam.live.control import check_speed
from gridslam.live.finished import count_key_scans, read_optional_history, read_results, read_truth
from gridslam.live.history import History, PastMaps, PastReplica
from gridslam.live.past import Past, PastReader
from gridslam.live.results import MappedRun, StaticView
from gridslam.live.scene import Scene, SentState, make_run_info
from gridslam.live.tiles import TileReplica
from gridslam.messages import Level, Messages


@final
class Replay:
    """The results of a finished run, as content of the page.

    Parameters
    ----------
    folder : str or Path
        OUT of `gridslam map`, `localize`, `grid`, `landmarks`, `graph` or `merge`.
    speed : float, > 0
        Initial factor on real time.
    is_editable : bool
        Whether the page shows the tools by which the map is edited.
    shown : StaticView, optional
        What is shown instead of results in the folder, which is none: a map of the session file of this name.

    Raises
    ------
    InputError
        A file is missing or malformed, the files are not of one run, or another command wrote the folder; a file is a
        link, or lies elsewhere: only those in the folder are read and served.
    """

    def __init__(
        self,
        folder: str | Path,
        speed: float = 10.0,
        is_editable: bool = False,
        *,
        shown: StaticView | None = None,
    ) -> None:
        """Read the folder."""
        out = Path(folder)
        with stay_below(out):
            results, title, self.messages = read_results(out) if shown is None else (shown, out.name, [])
            self.history = read_optional_history(out) if shown is None else None
            self.truth = read_truth(out, results.trajectory) if shown is None else NO_POINTS
        self.results = results
        if results.missing:
            messages = Messages(lambda level, text: None)
            messages.report(Level.WARN, results.missing)
            self.messages = [*messages.to_list(), *self.messages]
        mode = "still" if isinstance(results, StaticView) else "replay"
        self.speed = speed
        found = {"truth": len(self.truth) > 0, "edits": is_editable}
        if self.history is not None:
            found |= dict.fromkeys(("scan", "particles"), True)
        self.past_maps = PastMaps(self.history or History())
        self.keys = count_key_scans(results, self.history)
        layers = (
            *results.layers,
            *(name for name, is_found in found.items() if is_found and name not in results.layers),
        )
        self.run_info = make_run_info(title, mode, layers, results.step, results.grid)
        self.replica = TileReplica() if self.results.grid is None else TileReplica.of(self.results.grid)

    def add_viewer(self, notify: Callable[[], None]) -> ReplayViewer:
        """Add a viewer at the end of the run; `notify` is never called, as the content does not change."""
        return ReplayViewer(self)


@final
class ReplayViewer:
    """A viewer of a finished run, with its own time."""

    def __init__(self, replay: Replay) -> None:
        """Start at the end."""
        self._replay = replay
        self._results = replay.results
        self._sent = SentState()
        self._last = len(self._results.times_s) - 1
        self._at = self._last
        self._time_s = float(self._results.times_s[-1])
        self._speed = replay.speed
        self._played_until = 0.0
        self._playing = False
        self._reader = None if replay.history is None else PastReader(replay.history, replay.past_maps)
        self._past: Past | None = None
        self._look()

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""
        if self._playing:
            self._play()
        return self._sent.next_message(self._scene())

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command; raises ArgumentError, KeyError, TypeError or ValueError if it is invalid."""
        match command["do"]:
            case "pause":
                self._playing = False
            case "resume":
                if self._at == self._last:
                    self._seek(0)
                self._playing = True
                self._played_until = time.perf_counter()
            case "step":
                self._playing = False
                self._seek(min(self._at + 1, self._last))
            case "seek":
                self._seek(min(max(int(command["at"]), 0), self._last))
            case "speed":
                self._speed = check_speed(command["factor"]) or self._speed
            case what:
                raise ArgumentError("do", "pause, resume, step, seek or speed", what)

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
        self._time_s = float(self._results.times_s[at])
        self._played_until = time.perf_counter()
        self._move_to(at)

    def _move_to(self, at: int) -> None:
        if at == self._at:
            return
        self._at = at
        self._look()

    def _look(self) -> None:
        """Build the scene of a moment; of a map the final form at the end."""
        at = self._at
        self._frame = self._results.frame(at)
        is_map = isinstance(self._results, MappedRun)
        self._past = None
        if self._reader is None or (is_map and at == self._last):
            return
        self._past = past = self._reader.read(int(self._replay.keys[at]), has_maps=is_map)
        if past is None:
            return
        self._frame = past.frame if is_map else self._frame._replace(particles=past.frame.particles)

    def _scene(self) -> Scene:
        results = self._results
        status = {
            **results.status(self._at, self._time_s),
            "at": self._at,
            "last": self._last,
            "time_s": self._time_s,
            "total_s": float(results.times_s[-1]),
            "speed": self._speed,
        }
        if self._playing:
            status["stage"] = "looking" if status.get("looking") else "lost" if status.get("lost") else "running"
        else:
            status["stage"] = "finished" if self._at == self._last else "paused"
        replica: TileReplica | PastReplica = self._replay.replica
        past = self._past
        if past is not None and self._reader is not None:
            status["scan_pose"] = past.pose.tolist()
            if isinstance(results, MappedRun):
                replica = self._reader.replica
                status |= {"past": True, "pose": past.pose.tolist()}
        return Scene(
            self._replay.run_info,
            status,
            replica,
            self._frame,
            results.series,
            NO_POINTS if past is None else past.scan,
            plan=results.path,
            landmarks=results.landmarks,
            truth=self._replay.truth,
            messages=self._replay.messages,
        )
