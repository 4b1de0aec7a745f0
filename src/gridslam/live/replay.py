"""A finished run, shown again from its folder, with a time line: each viewer looks at a time of its own."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.errors import ArgumentError, InputError
from gridslam.io.g2o import read_g2o
from gridslam.io.map_server import read_map
from gridslam.io.record import Record, RecordFlag, read_record
from gridslam.io.trajectory import read_tum
from gridslam.live.control import checked_speed
from gridslam.live.options import LiveOptions
from gridslam.live.pasts import Pasts
from gridslam.live.run import greeting
from gridslam.live.scene import Float32Array, Scene, Sent, Way, rooted
from gridslam.live.server import PageServer
from gridslam.live.tiles import TileMirror, tiles_of
from gridslam.types import FloatArray, IntArray, OccupancyGrid, Trajectory

__all__ = ["Replay", "ReplayPage", "ReplayViewer"]


@final
class Replay:
    """The results of a run, as `gridslam map` wrote them.

    Parameters
    ----------
    folder : str or Path
        OUT of the run.

    Raises
    ------
    InputError
        A file is missing or malformed, or they are not of one run.
    """

    def __init__(self, folder: str | Path) -> None:
        """Read the folder."""
        out = Path(folder)
        document = _document(out / "run.json")
        self.record: Record = read_record(out / "record.npz")
        self.trajectory: Trajectory = read_tum(out / "trajectory.tum")
        self.grid: OccupancyGrid = read_map(out / "map.yaml")
        self.key_poses: FloatArray = read_g2o(out / "graph.g2o").graph.poses
        if not len(self.record) or len(self.key_poses) != len(self.record):
            raise InputError(out / "record.npz", f"expected {len(self.key_poses)} key scans, got {len(self.record)}")
        self.mirror = TileMirror()
        self.mirror.apply(tiles_of(self.grid))
        self.times_s = _elapsed(self.record.stamps_ns, self.record.stamps_ns[0])
        self.scan_times_s = _elapsed(self.trajectory.stamps_ns, self.record.stamps_ns[0])
        self.closures: IntArray = _closures(document, len(self.record))
        self.closure_ends = self.key_poses[self.closures, :2].reshape(-1, 4).astype(np.float32)
        self.way: Float32Array = self.key_poses[:, :2].astype(np.float32)
        columns = (self.times_s, self.record.n_eff, 1e3 * self.record.latency_s, self.record.flags)
        self.series: Float32Array = np.column_stack(columns).astype(np.float32)
        title = Path(str(document.get("input", {}).get("path") or out)).name
        self.hello = greeting(title, "replay", self.grid.resolution_m, self.record.poses.shape[1])

    def join(self, news: Callable[[], None]) -> ReplayViewer:
        """Take in a viewer, who looks at the end of the run; `news` is never called: nothing happens here."""
        return ReplayViewer(self)

    def map_of(self, channel: int) -> OccupancyGrid:
        """The map, whatever the channel."""
        return self.grid

    def moment(self, at: int, time_s: float) -> dict[str, Any]:
        """What there is to say of a time at or after key scan `at`."""
        record = self.record
        scan = max(int(np.searchsorted(self.scan_times_s, time_s, "right")) - 1, 0)
        return {
            "at": at, "keys": at + 1, "keys_total": len(record), "time_s": time_s, "total_s": float(self.times_s[-1]),
            "scans": scan + 1, "pose": self.trajectory.poses[scan].tolist(), "n_eff": float(record.n_eff[at]),
            "lost": bool(record.flags[at] & RecordFlag.LOST), "best": int(record.parents[at, record.best[at]]),
            "closures": int((self.closures[:, 1] <= at).sum()),
        }  # fmt: skip


@final
class ReplayViewer:
    """One who looks at a finished run, at a time of its own."""

    def __init__(self, replay: Replay) -> None:
        """Look at the end."""
        self._replay, self._sent, self._pasts = replay, Sent(), Pasts(replay.record)
        self._at, self._time_s = len(replay.record) - 1, float(replay.times_s[-1])
        self._speed, self._since = 10.0, 0.0
        self._playing = False
        self._watched: int | None = None
        self._scene: Scene | None = None

    def message(self) -> bytes | None:
        """What the viewer lacks; None where that is nothing."""
        if self._playing:
            self._play()
        self._scene = self._seen(self._scene)
        return self._sent.message(self._scene)

    def command(self, command: Mapping[str, Any]) -> None:
        """Do what the viewer asks; raises ArgumentError, KeyError, TypeError or ValueError where it cannot be done."""
        what, last = command["do"], len(self._replay.record) - 1
        if what == "pause":
            self._playing = False
        elif what == "resume":
            if self._at == last:
                self._go(0)
            self._playing, self._since = True, time.perf_counter()
        elif what == "step":
            self._playing = False
            self._go(min(self._at + 1, last))
        elif what == "seek":
            self._go(min(max(int(command["at"]), 0), last))
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
        times = self._replay.times_s
        self._playing = self._time_s < times[-1]
        self._time_s = min(self._time_s, float(times[-1]))
        self._follow(max(int(np.searchsorted(times, self._time_s, "right")) - 1, 0))

    def _go(self, at: int) -> None:
        self._time_s, self._since = float(self._replay.times_s[at]), time.perf_counter()
        self._follow(at)

    def _follow(self, at: int) -> None:
        if self._watched is not None:
            self._watched = self._pasts.relative(self._watched, self._at, at)
        self._at = at

    def _watch(self, particle: int | None) -> None:
        if particle is not None and not 0 <= particle < self._replay.record.poses.shape[1]:
            raise ArgumentError("particle", f"an index below {self._replay.record.poses.shape[1]}", particle)
        self._watched = particle

    def _seen(self, before: Scene | None) -> Scene:
        """The scene now; what is as in the one before stays the same object."""
        replay, at = self._replay, self._at
        record = replay.record
        status = {
            **replay.moment(at, self._time_s), "stage": "running" if self._playing else "paused", "speed": self._speed,
            "watched": self._watched,
        }  # fmt: skip
        if before is not None and before.status["at"] == at:
            return Scene(
                replay.hello, status, replay.mirror, before.path, before.tree, before.particles, before.scan,
                before.closures, replay.series, replay.way,
            )  # fmt: skip
        particles = np.column_stack([record.poses[at], np.exp(record.log_weights[at])]).astype(np.float32)
        closures = replay.closure_ends[replay.closures[:, 1] <= at]
        if before is not None and len(before.closures) == len(closures):
            closures = before.closures
        return Scene(
            replay.hello, status, replay.mirror, Way(replay.way[: at + 1]), rooted(self._pasts.at(at)), particles,
            np.zeros((0, 2), np.float32) if before is None else before.scan, closures, replay.series, replay.way,
        )  # fmt: skip


@final
class ReplayPage:
    """Serves the page of a finished run while its context is entered; reads the run at once (InputError)."""

    def __init__(self, folder: str | Path, options: LiveOptions | None = None) -> None:
        """Serve nothing yet."""
        self._server = PageServer(Replay(folder), options or LiveOptions())

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


def _document(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(path, "no such file; expected the folder that gridslam map wrote")
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(path, f"expected JSON, got: {error}") from None
    if not isinstance(document, dict) or not str(document.get("schema", "")).startswith("gridslam.run/"):
        raise InputError(path, "expected a document of schema gridslam.run")
    return document


def _closures(document: dict[str, Any], keys: int) -> IntArray:
    """Key scans (C, 2) of the loop closures, the older one first; those that the record does not have are left out."""
    told = document.get("loop_closure") or {}
    pairs = np.array([closure["key_scans"] for closure in told.get("closures", [])], np.int64).reshape(-1, 2)
    return pairs[(pairs >= 0).all(axis=1) & (pairs < keys).all(axis=1)]


def _elapsed(stamps_ns: IntArray, first_ns: int) -> FloatArray:
    """Seconds since the first stamp, never going back."""
    return np.maximum.accumulate((stamps_ns - first_ns) * 1e-9)
