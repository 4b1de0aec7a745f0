"""The viewers' side of a run: what its snapshots add up to, and what each viewer has of it."""

from __future__ import annotations

import math
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, final

import numpy as np

from gridslam import __version__
from gridslam.errors import ArgumentError
from gridslam.kernels import TILE
from gridslam.live.control import Control, RobotControl, checked_particle, checked_speed
from gridslam.live.observer import SEEN_S, UNSEEN_S, LiveObserver, Snapshot
from gridslam.live.protocol import STEP_NATS
from gridslam.live.scene import NO_CLOSURES, NO_PARTICLES, NO_POINTS, NO_TREE, Rows, Scene, Sent, Way
from gridslam.live.sight import BEST
from gridslam.live.tiles import TileMirror, offset_of, tiles_of
from gridslam.types import FloatArray, LaserScan, OccupancyGrid

__all__ = ["LIVE_SLAM", "LiveRun", "LiveViewer", "greeting"]

LIVE_SLAM = "map", "path", "pasts", "particles", "weights", "scan", "closures", "n_eff", "latency"
_LIVE_LOCALIZATION = "map", "path", "particles", "scan", "n_eff", "latency", "doubt"
_MOST_CHANNELS = 8
_RATE_OVER = 12  # snapshots


def greeting(
    title: str, mode: str, shows: tuple[str, ...], step: str = "key scan", grid: OccupancyGrid | None = None
) -> dict[str, Any]:
    """Build the first message to a viewer.

    `session` identifies a start of the server, `shows` names the layers and figures that there are, and `step`
    is the meaning of a row of the series. The cells of a known `grid` lie off the tiles' by `offset_m`.
    """
    return {
        "session": secrets.token_hex(8), "version": __version__, "title": title, "mode": mode, "shows": shows,
        "step": step, "tile": TILE, "step_nats": STEP_NATS, "resolution_m": None if grid is None else grid.resolution_m,
        "offset_m": (0.0, 0.0) if grid is None else offset_of(grid),
    }  # fmt: skip


def finite(value: float) -> float | None:
    """The value, or None if JSON cannot represent it."""
    return value if math.isfinite(value) else None


@final
class LiveRun:
    """What there is to see of a run; belongs to the server's thread.

    Parameters
    ----------
    title : str
        What is mapped.
    control : Control or RobotControl
        What viewers' pause, step and speed go to.
    range_max_m : float, m
        Beams of this range or more are not drawn.
    known : OccupancyGrid, optional
        The map, where that is known: then the robot is localized in it.
    """

    def __init__(
        self,
        title: str,
        control: Control | RobotControl,
        range_max_m: float = math.inf,
        known: OccupancyGrid | None = None,
    ) -> None:
        """Begin before the first snapshot."""
        self.observer: LiveObserver | None = None
        self.control = control
        self._title, self._range_max_m, self._known = title, range_max_m, known
        self._viewers: dict[LiveViewer, Callable[[], None]] = {}
        self._channels, self._says = 0, ""
        self.begin()

    def begin(self) -> None:
        """Begin before the first snapshot, with an empty map or the known one."""
        mode = "live" if isinstance(self.control, Control) else "robot"
        if self._known is None:
            self._hello = greeting(self._title, mode, LIVE_SLAM)
        else:
            self._hello = greeting(self._title, mode, _LIVE_LOCALIZATION, "update", self._known)
        self._mirrors = {BEST: TileMirror() if self._known is None else TileMirror.of(self._known)}
        self._rows = {BEST: 0}
        self._stage = "waiting"
        self._status: dict[str, Any] = {"keys": 0, "scans": 0, "particles": 0}
        self._path, self._tree = Way(), NO_TREE
        self._particles, self._scan, self._closures = NO_PARTICLES, NO_POINTS, NO_CLOSURES
        self._series = Rows(5)
        self._first_s: float | None = None
        self._paces: deque[tuple[float, int, float]] = deque(maxlen=_RATE_OVER)
        self._last_scan: LaserScan | None = None
        for viewer in self._viewers:
            viewer.show_best()
        self.tell_all()

    def apply(self, snapshot: Snapshot) -> None:
        """Take over a snapshot."""
        view = snapshot.view
        if self._stage == "waiting":
            self._hello = {**self._hello, "resolution_m": view.resolution_m}
            self._stage = "running"
        for channel, changes in view.maps.items():
            if channel in self._mirrors:
                self._mirrors[channel].apply(changes)
        self._rows = view.rows
        self._take_series(snapshot)
        way, self._tree = view.past()
        self._path = self._path.followed_by(way)
        closures = view.closures()
        if not np.array_equal(closures, self._closures):
            self._closures = closures
        self._particles = view.particles()
        if snapshot.scan is not None and snapshot.scan is not self._last_scan:
            self._last_scan = snapshot.scan
            self._scan = snapshot.scan.beams(0.05, self._range_max_m).ends.astype(np.float32)
        self._tell(snapshot)

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Show the final result: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        for mirror in self._mirrors.values():
            mirror.replace(tiles_of(grid))
        self._path = self._path.followed_by(poses[:, :2].astype(np.float32))
        self._tree = NO_TREE
        self._closures = closures.astype(np.float32)
        self._particles, self._scan = NO_PARTICLES, NO_POINTS
        self.enter("writing")

    def enter(self, stage: str) -> None:
        """Go over to another stage: "running", "final refinement", "writing" or "done"."""
        self._stage = stage
        self.tell_all()

    def say(self, words: str) -> None:
        """Show this message to viewers until it is replaced; none if empty."""
        self._says = words
        self.tell_all()

    def join(self, news: Callable[[], None]) -> LiveViewer:
        """Take in a viewer, whose `news` is called whenever there may be something new."""
        viewer = LiveViewer(self)
        self._viewers[viewer] = news
        self._count_viewers()
        return viewer

    def leave(self, viewer: LiveViewer) -> None:
        """Let a viewer go."""
        self._viewers.pop(viewer, None)
        self._count_viewers()

    @property
    def viewers(self) -> int:
        """How many are looking."""
        return len(self._viewers)

    def map_of(self, channel: int) -> OccupancyGrid:
        """The map that a channel shows; the best particle's where there is no such channel."""
        if self._known is not None:
            return self._known
        resolution_m = self._hello["resolution_m"] or 1.0
        return self._mirrors.get(channel, self._mirrors[BEST]).grid(resolution_m)

    def watch(self, particle: int) -> int:
        """Open a channel for the map of a particle; raises ArgumentError where there is none, or too many are open."""
        if self._known is not None:
            raise ArgumentError("do", "something else, as all particles have one map", "watch")
        particle = checked_particle(particle, self._status["particles"])
        if len(self._mirrors) > _MOST_CHANNELS:
            raise ArgumentError("particle", f"at most {_MOST_CHANNELS} maps at once", "one more")
        self._channels += 1
        self._mirrors[self._channels] = TileMirror()
        self._rows[self._channels] = particle
        if self.observer is not None:
            self.observer.watch(self._channels, particle, self._status["keys"])
        return self._channels

    def unwatch(self, channel: int) -> None:
        """Close a channel."""
        if self._mirrors.pop(channel, None) is not None and self.observer is not None:
            self.observer.watch(channel, -1, 0)

    def scene(self, channel: int) -> Scene:
        """What a viewer of this channel can see now."""
        row = self._rows.get(channel, -1)
        stage = "paused" if self._stage in ("waiting", "running") and self.control.paused else self._stage
        status = {
            **self._status, "stage": stage, "says": self._says, "speed": self.control.speed,
            "viewers": len(self._viewers), "channel": channel,
            "watched": None if channel == BEST or stage in ("writing", "done") else row,
        }  # fmt: skip
        return Scene(
            self._hello, status, self._mirrors.get(channel, self._mirrors[BEST]), self._path, self._tree,
            self._particles, self._scan, self._closures, self._series.all,
        )  # fmt: skip

    def tell_all(self) -> None:
        """Let every viewer look."""
        for news in self._viewers.values():
            news()

    def _count_viewers(self) -> None:
        if self.observer is not None:
            self.observer.period_s = SEEN_S if self._viewers else UNSEEN_S
        self.tell_all()

    def _take_series(self, snapshot: Snapshot) -> None:
        if not snapshot.series:
            return
        if self._first_s is None:
            self._first_s = snapshot.series[0][0]
        self._series.append(np.array(snapshot.series) * (1, 1, 1e3, 1, 1) - (self._first_s, 0, 0, 0, 0))

    def _tell(self, snapshot: Snapshot) -> None:
        report = snapshot.report
        stamp_s = report.stamp_ns * 1e-9
        first_s = stamp_s if self._first_s is None else self._first_s
        self._paces.append((snapshot.taken_s, snapshot.scans, stamp_s))
        wall_s, scans, log_s = (b - a for a, b in zip(self._paces[0], self._paces[-1], strict=True))
        pace = {"scans_per_s": scans / wall_s, "times": log_s / wall_s} if wall_s > 0 and scans else {}
        n_eff = finite(float(self._series.all[-1, 1])) if snapshot.keys else None
        self._status = {
            "scans": snapshot.scans, "keys": snapshot.keys, "time_s": stamp_s - first_s,
            "pose": report.pose.tolist(), "covariance": report.covariance.tolist(), "lost": bool(report.lost),
            "n_eff": n_eff, "share": finite(snapshot.share), **snapshot.view.facts(), **pace,
        }  # fmt: skip
        self.tell_all()


@final
class LiveViewer:
    """One who looks at a run."""

    def __init__(self, run: LiveRun) -> None:
        """Look at the best particle's map."""
        self._run, self._sent, self._channel = run, Sent(), BEST

    def message(self) -> bytes | None:
        """What the viewer lacks; None where that is nothing."""
        return self._sent.message(self._run.scene(self._channel))

    def command(self, command: Mapping[str, Any]) -> None:
        """Do what the viewer asks.

        Raises ArgumentError, KeyError or TypeError where that is nothing that can be asked.
        """
        run, what = self._run, command["do"]
        if what == "pause":
            run.control.pause()
        elif what == "resume":
            run.control.resume()
        elif what == "step":
            run.control.step(to_key_scan=bool(command.get("to_key_scan", True)))
        elif what == "speed":
            run.control.set_speed(checked_speed(command["times"]))
        elif what == "watch":
            self._watch(command["particle"])
        else:
            raise ArgumentError("do", "pause, resume, step, speed or watch", what)
        run.tell_all()

    def close(self) -> None:
        """Look no more."""
        self._watch(None)
        self._run.leave(self)

    def show_best(self) -> None:
        """Look at the best particle's map: the one that was looked at is no more."""
        self._channel = BEST

    def _watch(self, particle: int | None) -> None:
        before, self._channel = self._channel, BEST
        if before != BEST:
            self._run.unwatch(before)
        if particle is not None:
            self._channel = self._run.watch(particle)
