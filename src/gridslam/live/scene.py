"""The scene at one time, and the part of it that a viewer has not received yet."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.live.protocol import encode, pack_tiles
from gridslam.live.tiles import TileReplica
from gridslam.particles.ancestry import Ancestry
from gridslam.types import FloatArray

__all__ = [
    "NO_CLOSURES",
    "NO_LANDMARKS",
    "NO_PARTICLES",
    "NO_POINTS",
    "NO_SERIES",
    "NO_TREE",
    "AncestryTree",
    "RobotPath",
    "RowBuffer",
    "Scene",
    "SentState",
    "full_tree",
    "thin_tree",
]  # fmt: skip

Float32Array = NDArray[np.float32]

_MAX_TILES = 1024
_MAX_NODES = 1500  # of an ancestry tree; larger trees are thinned to every second, third, ... step
_STEPS_PER_UNIT = np.float32(64)  # per m: positions are rounded to 1.6 cm, which halves their compressed size
NO_POINTS: Float32Array = np.zeros((0, 2), np.float32)
NO_PARTICLES: Float32Array = np.zeros((0, 4), np.float32)
NO_CLOSURES: Float32Array = np.zeros((0, 4), np.float32)
NO_LANDMARKS: Float32Array = np.zeros((0, 5), np.float32)
NO_SERIES: Float32Array = np.zeros((0, 5), np.float32)


@final
class RowBuffer:
    """Append-only rows of numbers; rows already returned never change.

    Parameters
    ----------
    width : int
        Numbers per row.
    """

    __slots__ = ("_count", "_rows")

    def __init__(self, width: int) -> None:
        """Start without rows."""
        self._rows, self._count = np.zeros((256, width), np.float32), 0

    def append(self, rows: FloatArray) -> None:
        """Add rows (K, width)."""
        end = self._count + len(rows)
        if end > len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros((end, self._rows.shape[1]), np.float32)])
        self._rows[self._count : end] = rows
        self._count = end

    @property
    def rows(self) -> Float32Array:
        """All rows so far."""
        return self._rows[: self._count]


@final
@dataclass(frozen=True, slots=True, eq=False)
class RobotPath:
    """Positions (T, 2) of the robot at the key scans, NaN where lost; paths of one `revision` share their prefix."""

    positions: Float32Array = field(default_factory=lambda: NO_POINTS)
    revision: int = 0

    def with_positions(self, positions: Float32Array) -> RobotPath:
        """Return the path with new positions: of the same revision if positions were only appended."""
        common = min(len(positions), len(self.positions))
        same = np.array_equal(positions[:common], self.positions[:common], equal_nan=True)
        return RobotPath(positions, self.revision if same else self.revision + 1)


@final
@dataclass(frozen=True, slots=True, eq=False)
class AncestryTree:
    """The part of the particles' paths that they do not share.

    Attributes
    ----------
    positions : (M, 2) float32
        Positions of the nodes, to 1.6 cm.
    parents : (M,) int32
        Parent of each node; -1: the end of the shared path, -2: none.
    leaves : (N,) int32
        Node of each particle; -1: the end of the shared path.
    """

    positions: Float32Array
    parents: NDArray[np.int32]
    leaves: NDArray[np.int32]


NO_TREE = AncestryTree(NO_POINTS, np.zeros(0, np.int32), np.zeros(0, np.int32))
"""The tree of particles without ancestry."""


def thin_tree(ancestry: Ancestry, max_nodes: int = _MAX_NODES) -> tuple[Float32Array, AncestryTree]:
    """Return the path (T, 2) that all particles share, and the tree after it, thinned to about `max_nodes`."""
    arrays = ancestry.to_arrays()
    counts, parents, leaves = arrays["counts"], arrays["parents"], arrays["leaves"]
    begins = np.concatenate([[0], np.cumsum(counts)])
    stride = -(-len(parents) // max_nodes) or 1
    kept = range(len(counts) - 1, -1, -stride)  # levels, the newest first
    number = np.full(len(parents), -1, np.int64)  # of each kept node among those that are kept
    nodes = np.concatenate([np.arange(begins[k], begins[k + 1]) for k in reversed(kept)] or [leaves[:0]])
    number[nodes] = np.arange(len(nodes))
    before = np.full(len(parents), -1, np.int64)
    for level in kept:
        above = parents[begins[level] : begins[level + 1]]
        for between in range(level - 1, max(level - stride, -1), -1):
            above = parents[begins[between] : begins[between + 1]][above]
        if level >= stride:
            before[begins[level] : begins[level + 1]] = number[begins[level - stride] + above]
    ends = number[begins[-2] + leaves] if len(counts) else np.full(len(leaves), -1)
    positions = arrays["poses"][nodes, :2].astype(np.float32)
    tree = AncestryTree(
        np.rint(positions * _STEPS_PER_UNIT) / _STEPS_PER_UNIT, before[nodes].astype(np.int32), ends.astype(np.int32)
    )
    return arrays["trunk"][:, :2].astype(np.float32), tree


def full_tree(ancestry: Ancestry) -> AncestryTree:
    """Return all paths as one tree that includes the shared path."""
    trunk, tree = thin_tree(ancestry)
    count = len(trunk)
    stem = np.arange(-1, count - 1, dtype=np.int32)
    stem[:1] = -2
    parents = np.where(tree.parents < 0, count - 1 if count else -2, tree.parents + count)
    leaves = np.where(tree.leaves < 0, count - 1, tree.leaves + count)
    joined = np.concatenate([stem, parents.astype(np.int32)])
    return AncestryTree(np.concatenate([trunk, tree.positions]), joined, leaves.astype(np.int32))


@final
@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Everything displayed at one time; unchanged parts are the same objects as in the previous scene.

    Attributes
    ----------
    run_info : dict
        Constants of a session.
    status : dict
        Values that change with every scene.
    replica : TileReplica
        The displayed map.
    path : RobotPath
        Path of the robot that all particles share.
    tree : AncestryTree
        The differing paths of the particles.
    particles : (N, 4) float32
        x m, y m, theta rad, and weight.
    scan : (K, 2) float32, m
        End points of the current scan in the robot frame.
    closures : (C, 4) float32, m
        End points x, y of each loop closure.
    series : (S, 5) float32
        For each key scan its time since the first, s, effective sample size, latency, ms, flags
        (`gridslam.live.monitor`) and number of particles; NaN if unknown.
    plan : (P, 2) float32, m
        The future path of the robot; empty if unknown.
    landmarks : (L, 5) float32
        x m, y m, and covariance xx, xy, yy, m^2.
    """

    run_info: dict[str, Any]
    status: dict[str, Any]
    replica: TileReplica
    path: RobotPath
    tree: AncestryTree
    particles: Float32Array
    scan: Float32Array
    closures: Float32Array
    series: Float32Array
    plan: Float32Array = field(default_factory=lambda: NO_POINTS)
    landmarks: Float32Array = field(default_factory=lambda: NO_LANDMARKS)


@final
class SentState:
    """What a viewer has received; `next_message` encodes the rest."""

    __slots__ = ("_length", "_number", "_objects", "_replica", "_revision", "_run_info", "_series", "_status")

    def __init__(self) -> None:
        """Start with a viewer that has received nothing."""
        self._reset()

    def _reset(self) -> None:
        self._run_info: dict[str, Any] = {}
        self._replica: TileReplica | None = None
        self._number = 0
        self._revision, self._length, self._series = -1, 0, 0
        self._objects: dict[str, Any] = {}
        self._status: dict[str, Any] = {}

    def next_message(self, scene: Scene) -> bytes | None:
        """Encode the missing part of a scene; None if nothing is missing. Many tiles take several messages."""
        header: dict[str, Any] = {}
        arrays: dict[str, NDArray[Any]] = {}
        if self._run_info and scene.run_info["session"] != self._run_info["session"]:
            self._reset()
        if scene.run_info is not self._run_info:
            header["run_info"] = self._run_info = scene.run_info
        if scene.status != self._status:
            header["status"] = self._status = scene.status
        self._add_tiles(scene.replica, header, arrays)
        self._add_path(scene.path, header, arrays)
        if self._series != len(scene.series):
            first = self._series if self._series < len(scene.series) else 0
            header["series"] = first
            arrays["series"], self._series = scene.series[first:], len(scene.series)
        for name in ("particles", "scan", "closures", "plan", "landmarks"):
            self._add_whole(name, getattr(scene, name), {name: getattr(scene, name)}, arrays)
        tree = scene.tree
        named = {"tree": tree.positions, "tree_parents": tree.parents, "tree_leaves": tree.leaves}
        self._add_whole("tree", tree, named, arrays)
        return encode(header, arrays) if header or arrays else None

    def _add_whole(
        self, name: str, value: object, parts: dict[str, NDArray[Any]], arrays: dict[str, NDArray[Any]]
    ) -> None:
        if self._objects.get(name) is not value:
            self._objects[name] = value
            arrays.update(parts)

    def _add_tiles(self, replica: TileReplica, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        if replica is not self._replica:
            self._replica, self._number = replica, 0
            header["clear"] = True
        if replica.sequence > self._number:
            at, looks, self._number = replica.since(self._number, _MAX_TILES)
            arrays["tiles_at"], arrays["tiles"] = at, pack_tiles(looks)
            if replica.sequence > self._number:
                header["more"] = True

    def _add_path(self, path: RobotPath, header: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        if (path.revision, len(path.positions)) == (self._revision, self._length):
            return
        first = min(self._length, len(path.positions)) if path.revision == self._revision else 0
        header["path"], arrays["path"] = first, path.positions[first:]
        self._revision, self._length = path.revision, len(path.positions)
