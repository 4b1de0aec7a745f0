"""The page of a finished run, read from the folder of its command: each viewer has its own time line."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.live.finished import read_finished_run
from gridslam.live.history import SCAN_UNIT_M, PastReader
from gridslam.live.protocol import Float32Array
from gridslam.live.scene import NO_SERIES, Frame, Scene, SentState, make_run_info
from gridslam.live.tiles import TileReplica


@final
class Replay:
    """The results of a finished run, as content of the page; its steps are the key scans of the newest drive.

    Parameters
    ----------
    folder : str or Path
        OUT of `gridslam map`, `localize`, `grid` or `merge`. Without `history.npz` the end is shown alone.
    speed : float, > 0
        Initial factor on real time.

    Raises
    ------
    InputError
        A file is missing or malformed, the files are not of one run, or another command wrote the folder.
    """

    def __init__(self, folder: str | Path, speed: float = 10.0) -> None:
        """Read the folder."""
        out = Path(folder)
        found = read_finished_run(out)
        self.found = found
        history = found.history
        steps = 1 if history is None else len(history.stamps_ns)
        self.last = steps - 1
        self.series = NO_SERIES if history is None else history.series
        newest = found.poses if history is None else found.poses[-steps:]
        self.path: Float32Array = newest[:, :2].astype(np.float32)
        self.replica = TileReplica() if found.grid is None else TileReplica.of(found.grid)
        self.end = Frame(self.path)
        if history is not None:
            everything = history.make_frame(found.poses[:, :2].astype(np.float32))
            self.end = everything._replace(path=self.path)
        layers = {
            "map": found.grid is not None,
            "path": len(self.path) > 0,
            "closures": not found.is_localization and history is not None,
            "truth": len(found.truth) > 0,
            **dict.fromkeys(("scan", "particles", "n_eff", "latency"), history is not None),
        }
        shown = tuple(name for name, is_shown in layers.items() if is_shown)
        step = "update" if found.is_localization else "key scan"
        self.run_info = {**make_run_info(found.title, "replay", shown, step, found.grid), "speed": speed}

    def add_viewer(self) -> ReplayViewer:
        """Add a viewer at the end of the run."""
        return ReplayViewer(self)


@final
class ReplayViewer:
    """A viewer of a finished run, with its own time."""

    def __init__(self, replay: Replay) -> None:
        """Start at the end."""
        self._replay = replay
        self._sent = SentState()
        self._at = replay.last
        self._reader = None if replay.found.history is None else PastReader(replay.found.history)
        self._scene: Scene | None = None

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""
        if self._scene is None:
            self._scene = self._make_scene()
        return self._sent.next_message(self._scene)

    def command(self, command: Mapping[str, Any]) -> None:
        """Show another step; raises ArgumentError, KeyError, TypeError or ValueError if the command is invalid."""
        if command["do"] != "seek":
            raise ArgumentError("do", "seek", command["do"])
        self._at = min(max(int(command["at"]), 0), self._replay.last)
        self._scene = None

    def close(self) -> None:
        """Do nothing: the replay keeps no list of viewers."""

    def _make_scene(self) -> Scene:
        """Return the scene after a step; in the end the final map and path."""
        replay, at = self._replay, self._at
        found = replay.found
        status: dict[str, Any] = {"stage": "finished", "at": at, "last": replay.last}
        if found.history is not None:
            total_s = float(replay.series[-1, 0])
            status |= {**found.history.describe(at), "total_s": total_s, "pose": found.poses[-1].tolist()}
        scene = Scene(
            replay.run_info,
            status,
            replay.replica,
            replay.end,
            replay.series,
            plan=replay.path,
            truth=found.truth,
            messages=found.messages,
        )
        past = None if self._reader is None or at == replay.last else self._reader.read(at + 1)
        if past is None:
            return scene
        moment, frame = past
        scan = moment.scan.astype(np.float32) * np.float32(SCAN_UNIT_M)
        status |= {"past": True, "pose": moment.pose.tolist()}
        assert self._reader is not None
        replica = replay.replica if found.is_localization else self._reader.replica
        return scene._replace(frame=frame, scan=scan, replica=replica)
