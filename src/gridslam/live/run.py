"""The viewers' side of a run: the state accumulated from its snapshots, and one viewer per connection."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.live.ancestry_tree import NO_POINTS, Float32Array
from gridslam.live.control import Control, check_speed
from gridslam.live.history import History, PastMaps
from gridslam.live.observer import UNVIEWED_PERIOD_S, VIEWED_PERIOD_S, LiveObserver, Snapshot
from gridslam.live.past import PastReader
from gridslam.live.replay import Replay, ReplayViewer
from gridslam.live.scene import MOST_MESSAGES, Frame, Scene, SentState, finite_or_none, make_run_info
from gridslam.live.tiles import TileReplica, split_into_tiles
from gridslam.types import FloatArray, LaserScan, OccupancyGrid

_LIVE_SLAM = "map", "path", "ancestry", "particles", "scan", "closures", "n_eff", "latency"
_LIVE_LOCALIZATION = "map", "path", "particles", "scan", "n_eff", "latency", "lost_probability"
_RATE_SNAPSHOTS = 12


@final
class LiveRun:
    """Content of the page of a run; used by the server's thread only.

    Parameters
    ----------
    title : str
        Title of the page.
    control : Control
        Target of the viewers' pause, step and speed.
    range_max_m : float, m
        Beams of this range or more are not displayed.
    known : OccupancyGrid, optional
        The known map of a localization.
    is_robot : bool
        Whether a robot is shown, which cannot be paused or delayed.
    """

    def __init__(
        self,
        title: str,
        control: Control,
        range_max_m: float = math.inf,
        known: OccupancyGrid | None = None,
        *,
        is_robot: bool = False,
    ) -> None:
        """Start before the first snapshot."""
        self.observer: LiveObserver  # set before there are viewers
        self.control = control
        self._title = title
        self._range_max_m = range_max_m
        self._known = known
        self._viewers: dict[LiveViewer, Callable[[], None]] = {}
        self._initial_speed = control.speed
        self._messages: Sequence[Mapping[str, Any]] = ()
        self.is_robot = is_robot
        self._state: tuple[str, str] | None = None  # of a node: name and text
        self._goes_on: dict[str, Any] | None = None
        self._past: tuple[History, PastMaps] | None = None
        self.replay: Replay | None = None
        self.reset()

    def reset(self) -> None:
        """Start before the first snapshot of a session, with an empty map or the known one."""
        mode = "robot" if self.is_robot else "live"
        if self._known is None:
            self._run_info = make_run_info(self._title, mode, _LIVE_SLAM)
        else:
            self._run_info = make_run_info(self._title, mode, _LIVE_LOCALIZATION, "update", self._known)
        self._replica = TileReplica() if self._known is None else TileReplica.of(self._known)
        self._stage = "waiting"
        self._status: dict[str, Any] = {"keys": 0, "scans": 0, "particles": 0}
        self._frame = Frame()
        self._scan = NO_POINTS
        self._history = History()
        self._rate_window: deque[tuple[float, int, float]] = deque(maxlen=_RATE_SNAPSHOTS)
        self._last_scan: LaserScan | None = None
        for viewer in self._viewers:
            viewer.show_present()
        self.notify_viewers()

    def apply(self, snapshot: Snapshot) -> None:
        """Apply a snapshot."""
        view = snapshot.view
        if self._stage == "waiting":
            self._run_info = {**self._run_info, "resolution_m": view.resolution_m}
            self._stage = "running"
        if view.changes is not None:
            self._replica.apply(view.changes)
        self._history = snapshot.history
        self._frame = view.make_frame()
        if snapshot.scan is not None and snapshot.scan is not self._last_scan:
            self._last_scan = snapshot.scan
            self._scan = snapshot.scan.beams(0.05, self._range_max_m).ends.astype(np.float32)
        self._update_status(snapshot)

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Show the final result: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        self._replica.replace(split_into_tiles(grid))
        self._frame = Frame(poses[:, :2].astype(np.float32), closures=closures.astype(np.float32))
        self._scan = NO_POINTS
        self.set_stage("writing")

    def set_stage(self, stage: str) -> None:
        """Go over to another stage: "running", "final refinement", "writing" or "finished"."""
        self._stage = stage
        self.notify_viewers()

    def show_messages(self, messages: Sequence[Mapping[str, Any]]) -> None:
        """Show these messages, the newest first, instead of those before (`gridslam.messages.Messages.to_list`)."""
        self._messages = messages[:MOST_MESSAGES]
        self.notify_viewers()

    def show_state(self, name: str, text: str) -> None:
        """Show the state of a node, by its name and in words, until the next one."""
        self._state = name, text
        self.notify_viewers()

    def add_viewer(self, notify: Callable[[], None]) -> LiveViewer:
        """Add a viewer; `notify` is called whenever there may be something new."""
        viewer = LiveViewer(self)
        self._viewers[viewer] = notify
        self._count_viewers()
        return viewer

    def remove_viewer(self, viewer: LiveViewer) -> None:
        """Remove a viewer; with the last one pauses and speeds that viewers have set end."""
        self._viewers.pop(viewer, None)
        if not self._viewers:
            self.control.resume()
            self.control.set_speed(self._initial_speed)
        self._count_viewers()

    @property
    def viewers(self) -> int:
        """Number of viewers."""
        return len(self._viewers)

    def begin_replay(self, replay: Replay) -> None:
        """Let each viewer look through the finished run."""
        self.replay = replay
        self.notify_viewers()

    def show_session(self, name: str, drives: Sequence[str]) -> None:
        """Show the session that the run continues: the name of its file, and its drives."""
        goes_on = {"name": name, "drives": list(drives)}
        if goes_on != self._goes_on:
            self._goes_on = goes_on
            self.notify_viewers()

    def make_scene(self) -> Scene:
        """Return the current scene."""
        stage, text = self._find_stage()
        status = {
            **self._status,
            "stage": stage,
            "state": text,
            "goes_on": self._goes_on,
            "speed": self.control.speed,
            "viewers": len(self._viewers),
            "shared": self._frame.shared,
            "last": max(self._status["keys"] - 1, 0),
        }
        return Scene(
            self._run_info,
            status,
            self._replica,
            self._frame,
            self._series,
            self._scan,
            messages=self._messages,
        )

    def _find_stage(self) -> tuple[str, str]:
        """Return the name of the stage, and a node's own words for it."""
        if self._stage not in ("waiting", "running"):
            return self._stage, ""
        if self.control.paused:
            return "paused", ""
        if self._state is not None:
            return self._state
        if self._stage == "running" and self._status.get("lost"):
            return ("looking" if self._status.get("looking") else "lost"), ""
        return self._stage, ""

    def make_past_scene(self, reader: PastReader, at: int) -> Scene | None:
        """Return the scene as it was after a key scan, counted from 0; None if nothing is known of it."""
        past = reader.read(at + 1, has_maps=self._known is None)
        if past is None:
            return None
        status = {
            **self.make_scene().status,
            **self._history.describe(at),
            "past": True,
            "at": at,
            "pose": past.pose.tolist(),
            "scan_pose": past.pose.tolist(),
            "covariance": None,
            "best": None,
            "found": None,
            "progress": None,
            "real_time_factor": None,
            "bytes": None,
        }
        replica = self._replica if self._known is not None else reader.replica
        return Scene(self._run_info, status, replica, past.frame, self._series, past.scan, messages=self._messages)

    def find_reader(self, reader: PastReader | None) -> PastReader:
        """Return a viewer's reader of the current session's past: its own, if that is still of this session."""
        history = self._history
        if reader is not None and reader.reads(history):
            return reader
        if self._past is None or self._past[0] is not history:
            self._past = history, PastMaps(history)
        return PastReader(history, self._past[1])

    @property
    def keys(self) -> int:
        """Number of key scans that viewers can go back to."""
        return int(self._status["keys"])

    @property
    def _series(self) -> Float32Array:
        """Figures of each key scan, as in a scene."""
        return self._history.series[: self.keys]

    def notify_viewers(self) -> None:
        """Notify all viewers of a change."""
        for notify in self._viewers.values():
            notify()

    def _count_viewers(self) -> None:
        self.observer.period_s = VIEWED_PERIOD_S if self._viewers else UNVIEWED_PERIOD_S
        self.notify_viewers()

    def _find_covariance(self, snapshot: Snapshot) -> FloatArray:
        """Return the covariance (3, 3) of the pose; of a robot lost in a known map that of the drawn particles.

        The filter's own spans all places where the robot may be.
        """
        report, particles = snapshot.report, self._frame.particles
        if self._known is None or not report.lost or not len(particles):
            return report.covariance
        apart = particles[:, :3] - report.pose
        apart[:, 2] = wrap(apart[:, 2])
        weights = particles[:, 3] / particles[:, 3].sum()
        covariance: FloatArray = (weights[:, None] * apart).T @ apart
        return covariance

    def _update_status(self, snapshot: Snapshot) -> None:
        report = snapshot.report
        stamp_s = report.stamp_ns * 1e-9
        first_s = 1e-9 * self._history.stamps_ns[0] if snapshot.keys else stamp_s
        self._rate_window.append((snapshot.taken_s, snapshot.scans, stamp_s))
        wall_s, scans, log_s = (b - a for a, b in zip(self._rate_window[0], self._rate_window[-1], strict=True))
        rates = {"scans_per_s": scans / wall_s, "real_time_factor": log_s / wall_s} if wall_s > 0 and scans else {}
        n_eff = finite_or_none(float(self._history.series[snapshot.keys - 1, 1])) if snapshot.keys else None
        self._status = {
            "scans": snapshot.scans,
            "keys": snapshot.keys,
            "time_s": stamp_s - first_s,
            "pose": report.pose.tolist(),
            "covariance": self._find_covariance(snapshot).tolist(),
            "lost": bool(report.lost),
            "n_eff": n_eff,
            "progress": finite_or_none(snapshot.progress),
            **snapshot.view.status,
            **rates,
        }
        self.notify_viewers()


@final
class LiveViewer:
    """A viewer of a run."""

    def __init__(self, run: LiveRun) -> None:
        """Follow the run."""
        self._run = run
        self._sent = SentState()
        self._at: int | None = None  # the key scan that is looked at; None: the newest
        self._reader: PastReader | None = None
        self._replaying: ReplayViewer | None = None  # once the run is finished

    def next_message(self) -> bytes | None:
        """Return the next message for the viewer; None if there is nothing new."""
        if self._run.replay is not None:
            self._replaying = self._replaying or ReplayViewer(self._run.replay)
            return self._replaying.next_message()
        scene = None
        if self._at is not None and self._reader is not None:
            scene = self._run.make_past_scene(self._reader, self._at)
        return self._sent.next_message(self._run.make_scene() if scene is None else scene)

    def command(self, command: Mapping[str, Any]) -> None:
        """Execute a command of the viewer; raises ArgumentError, KeyError or TypeError if it is invalid."""
        if self._replaying is not None:
            self._replaying.command(command)
            return
        run = self._run
        match command["do"]:
            case "pause" | "resume" | "step" | "speed" as what if run.is_robot:
                raise ArgumentError("do", "seek, as a robot drives on", what)
            case "pause":
                run.control.pause()
            case "resume":
                run.control.resume()
            case "step":
                run.control.step(to_key_scan=bool(command.get("to_key_scan", True)))
            case "speed":
                run.control.set_speed(check_speed(command["factor"]))
            case "seek":
                self._seek(int(command["at"]))
            case what:
                raise ArgumentError("do", "pause, resume, step, seek or speed", what)
        run.notify_viewers()

    def close(self) -> None:
        """Remove the viewer."""
        self._run.remove_viewer(self)

    def show_present(self) -> None:
        """Follow the run, whose past is another one now."""
        self._at = None

    def _seek(self, at: int) -> None:
        """Show the run after a key scan, counted from 0; at the newest one follow the run."""
        self._at = None if at >= self._run.keys - 1 else max(at, 0)
        if self._at is not None:
            self._reader = self._run.find_reader(self._reader)
