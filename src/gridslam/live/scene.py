"""The scene at one time, and the part of it that a viewer has not received yet."""

from __future__ import annotations

import math
import secrets
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam import __version__
from gridslam.kernels import TILE
from gridslam.live.protocol import NO_POINTS, STEP_NATS, Float32Array, encode
from gridslam.live.tiles import TileReplica, tile_offset
from gridslam.types import FloatArray, OccupancyGrid

_MAX_TILES = 1024
MOST_MESSAGES = 100
"""Of a run that are shown: the newest ones."""
NO_PARTICLES: Float32Array = np.zeros((0, 4), np.float32)
NO_SERIES: Float32Array = np.zeros((0, 5), np.float32)


@final
class Frame(NamedTuple):
    """A run at one time.

    Attributes
    ----------
    path : (T, 2) float32, m
        Positions of the shown trajectory in full, NaN where lost: the best particle's while a filter runs.
    particles : (N, 4) float32
        x m, y m, theta rad, and weight.
    closures : (C, 4) float32, m
        End points x, y of each loop closure.
    """

    path: Float32Array = NO_POINTS
    particles: Float32Array = NO_PARTICLES
    closures: Float32Array = np.zeros((0, 4), np.float32)


@final
class Scene(NamedTuple):
    """Everything displayed at one time.

    Attributes
    ----------
    run_info : dict
        Constants of a session.
    status : dict
        Values that change with every scene.
    replica : TileReplica
        The displayed map.
    frame : Frame
        Path, particles and loop closures.
    series : (S, 5) float32
        For each key scan its time since the first, s, effective sample size, latency, ms, flags
        (`gridslam.live.history`) and number of particles; NaN if unknown.
    scan : (K, 2) float32, m
        End points of the current scan in the robot frame.
    plan : (P, 2) float32, m
        The future path of the robot; empty if unknown.
    truth : (P, 2) float32, m
        The true path of the robot; empty if unknown.
    messages : sequence of dict
        What was reported so far (`gridslam.messages.Messages.to_list`).
    """

    run_info: dict[str, Any]
    status: dict[str, Any]
    replica: TileReplica
    frame: Frame
    series: Float32Array
    scan: Float32Array = NO_POINTS
    plan: Float32Array = NO_POINTS
    truth: Float32Array = NO_POINTS
    messages: Sequence[Mapping[str, Any]] = ()


def make_run_info(
    title: str, mode: str, layers: tuple[str, ...], step: str = "key scan", grid: OccupancyGrid | None = None
) -> dict[str, Any]:
    """Build the first message to a viewer.

    `session` identifies a start of the server, `layers` names the layers and figures that there are, and `step`
    is the meaning of a row of the series. The cells of a known `grid` lie off the tiles' by `offset_m`.
    """
    return {
        "session": secrets.token_hex(8),
        "version": __version__,
        "title": title,
        "mode": mode,
        "layers": layers,
        "step": step,
        "tile": TILE,
        "step_nats": STEP_NATS,
        "resolution_m": None if grid is None else grid.resolution_m,
        "offset_m": (0.0, 0.0) if grid is None else tile_offset(grid),
    }


def finite_or_none(value: float) -> float | None:
    """Return the value, or None if JSON cannot represent it."""
    return value if math.isfinite(value) else None


@final
class SentState:
    """The data that a viewer has received; `next_message` encodes the rest."""

    def __init__(self) -> None:
        """Start with a viewer that has received nothing."""
        self._reset()

    def _reset(self) -> None:
        self._values: dict[str, Any] = {}
        self._replica: TileReplica | None = None
        self._number = 0  # of the last of its changes
        self._rows = {"path": NO_POINTS, "series": NO_SERIES}
        self._arrays: dict[str, NDArray[Any]] = {}

    def next_message(self, scene: Scene) -> bytes | None:
        """Encode the missing part of a scene; None if nothing is missing. Many tiles take several messages."""
        if self._values and scene.run_info["session"] != self._values["run_info"]["session"]:
            self._reset()
        values = {"run_info": scene.run_info, "status": scene.status, "messages": scene.messages}
        header = {name: value for name, value in values.items() if value != self._values.get(name)}
        arrays: dict[str, NDArray[Any]] = {}
        self._values = values
        self._add_tiles(scene.replica, header, arrays)
        self._add_rows("path", scene.frame.path, header, arrays)
        self._add_rows("series", scene.series, header, arrays)
        for name, array in (
            ("particles", scene.frame.particles),
            ("closures", scene.frame.closures),
            ("scan", scene.scan),
            ("plan", scene.plan),
            ("truth", scene.truth),
        ):
            if name not in self._arrays or not np.array_equal(self._arrays[name], array, equal_nan=True):
                self._arrays[name] = arrays[name] = array
        return encode(header, arrays) if header or arrays else None

    def _add_rows(self, name: str, rows: Float32Array, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Add the rows after those that the viewer has."""
        before = self._rows[name]
        first = count_common(before, rows)
        if first < max(len(before), len(rows)):
            header[name] = first
            arrays[name] = rows[first:]
            self._rows[name] = rows

    def _add_tiles(self, replica: TileReplica, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Add the changed tiles of the map."""
        if replica is not self._replica:
            self._replica = replica
            self._number = 0
            header["clear"] = True
        if replica.sequence > self._number:
            arrays["tiles_at"], arrays["tiles"], self._number = replica.since(self._number, _MAX_TILES)
            if replica.sequence > self._number:
                header["more"] = True


def count_common(a: FloatArray | Float32Array, b: FloatArray | Float32Array) -> int:
    """Return how many rows, from the first on, are the same."""
    count = min(len(a), len(b))
    if a is b:
        return count
    same = ((a[:count] == b[:count]) | (np.isnan(a[:count]) & np.isnan(b[:count]))).all(axis=1)
    return count if same.all() else int(np.argmin(same))
