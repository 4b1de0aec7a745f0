"""Content of the page of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.live.observer import UNVIEWED_PERIOD_S, VIEWED_PERIOD_S, LiveObserver
from gridslam.live.protocol import NO_POINTS
from gridslam.live.replay import Replay, ReplayViewer
from gridslam.live.scene import MOST_MESSAGES, NO_SERIES, Frame, Scene, SentState, make_run_info
from gridslam.live.tiles import TileReplica
from gridslam.types import FloatArray, OccupancyGrid

_LIVE_SLAM = "map", "path", "particles", "scan", "closures", "n_eff", "latency"
_LIVE_LOCALIZATION = "map", "path", "particles", "scan", "n_eff", "latency", "lost_probability"


@final
class LiveRun:
    """Content of the page of a run: the filter's thread shows scenes, the server's thread sends them to the viewers.

    Parameters
    ----------
    title : str
        Title of the page.
    known : OccupancyGrid, optional
        The known map of a localization.

    Attributes
    ----------
    observer : LiveObserver
        Shows the run; set before there are viewers.
    replay : Replay or None
        What viewers see of the finished run, once there is one.
    viewers : set of LiveViewer
        Who looks on.
    stage : str
        "waiting", "running", "final refinement", "writing" or "finished".
    state : (str, str) or None
        The state of a node, by its name and in words.
    messages : sequence of dict
        The messages so far, the newest first (`gridslam.messages.Messages.to_list`).
    """

    def __init__(self, title: str, known: OccupancyGrid | None = None) -> None:
        """Start before the first scan."""
        self.observer: LiveObserver
        self.replay: Replay | None = None
        self.viewers: set[LiveViewer] = set()
        self.state: tuple[str, str] | None = None
        self.messages: Sequence[Mapping[str, Any]] = ()
        self._title = title
        self._known = known
        self.reset()

    def reset(self) -> None:
        """Start before the first scan of a session, with an empty map or the known one."""
        known = self._known
        if known is None:
            run_info = make_run_info(self._title, "live", _LIVE_SLAM)
        else:
            run_info = make_run_info(self._title, "live", _LIVE_LOCALIZATION, "update", known)
        replica = TileReplica() if known is None else TileReplica.of(known)
        self._scene = Scene(run_info, {"keys": 0, "scans": 0, "particles": 0}, replica, Frame(), NO_SERIES)
        self.stage = "waiting"

    def show(self, scene: Scene) -> None:
        """Show a scene of the observer."""
        before = self._scene
        replica = scene.replica if self._known is None else before.replica
        self._scene = scene._replace(run_info={**before.run_info, **scene.run_info}, replica=replica)
        if self.stage == "waiting":
            self.stage = "running"

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Show the final result: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        frame = Frame(poses[:, :2].astype(np.float32), closures=closures.astype(np.float32))
        self._scene = self._scene._replace(replica=TileReplica.of(grid), frame=frame, scan=NO_POINTS)
        self.stage = "writing"

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
        scene = self._scene
        stage, text = self._find_stage(scene.status)
        status = {**scene.status, "stage": stage, "state": text}
        return scene._replace(status=status, messages=self.messages[:MOST_MESSAGES])

    def _find_stage(self, status: Mapping[str, Any]) -> tuple[str, str]:
        """Return the name of the stage, and a node's own words for it."""
        if self.stage not in ("waiting", "running"):
            return self.stage, ""
        if self.state is not None:
            return self.state
        if self.stage == "running" and status.get("lost"):
            return ("looking" if status.get("looking") else "lost"), ""
        return self.stage, ""


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
