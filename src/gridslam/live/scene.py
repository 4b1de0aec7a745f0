"""What there is to see at one moment, and what of it one viewer has not got yet."""

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
_MAX_NODES = 1500  # of a tree of pasts; of more every second, third, ... step is drawn
_STEPS_PER_UNIT = np.float32(64)  # to the m: its places are rounded to 1.6 cm, which halves what is sent of them
NO_POINTS: Float32Array = np.zeros((0, 2), np.float32)
NO_PARTICLES: Float32Array = np.zeros((0, 4), np.float32)
NO_CLOSURES: Float32Array = np.zeros((0, 4), np.float32)
NO_LANDMARKS: Float32Array = np.zeros((0, 5), np.float32)
NO_SERIES: Float32Array = np.zeros((0, 5), np.float32)


@final
class RowBuffer:
    """Rows of numbers that become more and more; those that were given out stay as they are.

    Parameters
    ----------
    width : int
        Numbers in a row.
    """

    __slots__ = ("_count", "_rows")

    def __init__(self, width: int) -> None:
        """Begin without any."""
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
        """All rows until now."""
        return self._rows[: self._count]


@final
@dataclass(frozen=True, slots=True, eq=False)
class RobotPath:
    """Places (T, 2) of the robot at the key scans, NaN where it was lost; of one `revision` they begin alike."""

    positions: Float32Array = field(default_factory=lambda: NO_POINTS)
    revision: int = 0

    def with_positions(self, positions: Float32Array) -> RobotPath:
        """The path as it is now: of the same edition if nothing but its end is new."""
        common = min(len(positions), len(self.positions))
        same = np.array_equal(positions[:common], self.positions[:common], equal_nan=True)
        return RobotPath(positions, self.revision if same else self.revision + 1)


@final
@dataclass(frozen=True, slots=True, eq=False)
class AncestryTree:
    """What the particles have not in common of their pasts.

    Attributes
    ----------
    positions : (M, 2) float32
        Where they were, to 1.6 cm.
    parents : (M,) int32
        For each place the one before it; -1 for the end of the path that is drawn, -2 where there is none before it.
    leaves : (N,) int32
        Place of each particle; -1 where all share all.
    """

    positions: Float32Array
    parents: NDArray[np.int32]
    leaves: NDArray[np.int32]


NO_TREE = AncestryTree(NO_POINTS, np.zeros(0, np.int32), np.zeros(0, np.int32))
"""Of particles without pasts."""


def thin_tree(ancestry: Ancestry, max_nodes: int = _MAX_NODES) -> tuple[Float32Array, AncestryTree]:
    """The path (T, 2) that all particles share, and the tree that it ends in, thinned to about `max_nodes` nodes."""
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
    """All pasts as a tree that begins with what they share."""
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
    """All that can be seen at one moment; what did not change is the same object as in the scene before.

    Attributes
    ----------
    run_info : dict
        What does not change during a session.
    status : dict
        What changes with every scene: numbers and words.
    replica : TileReplica
        The map that is shown.
    path : RobotPath
        Where the robot was, as far as all particles agree.
    tree : AncestryTree
        Where they do not.
    particles : (N, 4) float32
        Their x m, y m, theta rad, and weight.
    scan : (K, 2) float32, m
        Ends of the current scan's beams, seen from the robot.
    closures : (C, 4) float32, m
        The two places x, y that each loop closure joins.
    series : (S, 5) float32
        For each key scan its time since the first, s, effective sample size, latency, ms, flags
        (`gridslam.live.monitor`) and number of particles; NaN where that is not known.
    plan : (P, 2) float32, m
        Where the robot will go; empty where nobody knows.
    landmarks : (L, 5) float32
        Their x m, y m, and covariance xx, xy, yy, m^2.
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
    """What one viewer has got; `message` brings the rest."""

    __slots__ = ("_length", "_number", "_objects", "_replica", "_revision", "_run_info", "_series", "_status")

    def __init__(self) -> None:
        """Begin with a viewer who has got nothing."""
        self._reset()

    def _reset(self) -> None:
        self._run_info: dict[str, Any] = {}
        self._replica: TileReplica | None = None
        self._number = 0
        self._revision, self._length, self._series = -1, 0, 0
        self._objects: dict[str, Any] = {}
        self._status: dict[str, Any] = {}

    def next_message(self, scene: Scene) -> bytes | None:
        """What a viewer lacks of a scene; None where that is nothing. Of many tiles the rest is left for the next."""
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
