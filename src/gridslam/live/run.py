"""The viewers' side of a run: the state accumulated from its snapshots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.live.observer import UNVIEWED_PERIOD_S, VIEWED_PERIOD_S, LiveObserver, Snapshot
from gridslam.live.protocol import NO_POINTS
from gridslam.live.replay import Replay, ReplayViewer
from gridslam.live.scene import MOST_MESSAGES, NO_SERIES, Frame, Scene, SentState, make_run_info
from gridslam.live.tiles import TileReplica
from gridslam.types import FloatArray, OccupancyGrid

_LIVE_SLAM = "map", "path", "particles", "scan", "closures", "n_eff", "latency"
_LIVE_LOCALIZATION = "map", "path", "particles", "scan", "n_eff", "latency", "lost_probability"


@final
class LiveRun:
    """Content of the page of a run; used by the server's thread only.

    Parameters
    ----------
    title : str
        Title of the page.
    known : OccupancyGrid, optional
        The known map of a localization.

    Attributes
    ----------
    observer : LiveObserver
        Takes the snapshots; set before there are viewers.
    replay : Replay or None
        What viewers see of the finished run, once there is one.
    viewers : set of LiveViewer
        Who looks on.
    """

    def __init__(self, title: str, known: OccupancyGrid | None = None) -> None:
        """Start before the first snapshot."""
        self.observer: LiveObserver
        self.replay: Replay | None = None
        self.viewers: set[LiveViewer] = set()
        self._title = title
        self._known = known
        self._messages: Sequence[Mapping[str, Any]] = ()
        self._state: tuple[str, str] | None = None  # of a node: name and text
        self.reset()

    def reset(self) -> None:
        """Start before the first snapshot of a session, with an empty map or the known one."""
        if self._known is None:
            self._run_info = make_run_info(self._title, "live", _LIVE_SLAM)
        else:
            self._run_info = make_run_info(self._title, "live", _LIVE_LOCALIZATION, "update", self._known)
        self._replica = TileReplica() if self._known is None else TileReplica.of(self._known)
        self._stage = "waiting"
        self._status: dict[str, Any] = {"keys": 0, "scans": 0, "particles": 0}
        self._frame = Frame()
        self._scan = NO_POINTS
        self._series = NO_SERIES

    def apply(self, snapshot: Snapshot) -> None:
        """Apply a snapshot."""
        if self._stage == "waiting":
            self._stage = "running"
        if self._known is None:
            self._run_info = {**self._run_info, "resolution_m": snapshot.resolution_m}
            self._replica = snapshot.replica
        self._status = snapshot.status
        self._frame = snapshot.frame
        self._scan = snapshot.scan
        self._series = snapshot.series

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Show the final result: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        self._replica = TileReplica.of(grid)
        self._frame = Frame(poses[:, :2].astype(np.float32), closures=closures.astype(np.float32))
        self._scan = NO_POINTS
        self._stage = "writing"

    def set_stage(self, stage: str) -> None:
        """Go over to another stage: "running", "final refinement", "writing" or "finished"."""
        self._stage = stage

    def show_messages(self, messages: Sequence[Mapping[str, Any]]) -> None:
        """Show these messages, the newest first, instead of those before (`gridslam.messages.Messages.to_list`)."""
        self._messages = messages[:MOST_MESSAGES]

    def show_state(self, name: str, text: str) -> None:
        """Show the state of a node, by its name and in words, until the next one."""
        self._state = name, text

    def begin_replay(self, replay: Replay) -> None:
        """Let each viewer look through the finished run."""
        self.replay = replay

    def add_viewer(self) -> LiveViewer:
        """Add a viewer."""
        viewer = LiveViewer(self)
        self.viewers.add(viewer)
        self.observer.period_s = VIEWED_PERIOD_S
        return viewer

    def remove_viewer(self, viewer: LiveViewer) -> None:
        """Remove a viewer."""
        self.viewers.discard(viewer)
        if not self.viewers:
            self.observer.period_s = UNVIEWED_PERIOD_S

    def make_scene(self) -> Scene:
        """Return the current scene."""
        stage, text = self._find_stage()
        status = {**self._status, "stage": stage, "state": text}
        scene = Scene(self._run_info, status, self._replica, self._frame, self._series, self._scan)
        return scene._replace(messages=self._messages)

    def _find_stage(self) -> tuple[str, str]:
        """Return the name of the stage, and a node's own words for it."""
        if self._stage not in ("waiting", "running"):
            return self._stage, ""
        if self._state is not None:
            return self._state
        if self._stage == "running" and self._status.get("lost"):
            return ("looking" if self._status.get("looking") else "lost"), ""
        return self._stage, ""


@final
class LiveViewer:
    """A viewer of a run, and of its replay when it is finished."""

    def __init__(self, run: LiveRun) -> None:
        """Follow the run."""
        self._run = run
        self._sent = SentState()
        self._replaying: ReplayViewer | None = None

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""
        if self._replaying is None and self._run.replay is not None:
            self._replaying = self._run.replay.add_viewer()
        if self._replaying is not None:
            return self._replaying.next_message()
        return self._sent.next_message(self._run.make_scene())

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command of the viewer, which a running filter takes none of; raises ArgumentError then."""
        if self._replaying is None:
            raise ArgumentError("do", "nothing while the filter runs", command["do"])
        self._replaying.command(command)

    def close(self) -> None:
        """Remove the viewer."""
        self._run.remove_viewer(self)
