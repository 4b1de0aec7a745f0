"""Planar pose graphs in g2o's text form: lines VERTEX_SE2, EDGE_SE2 and FIX."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.angles import wrap
from gridslam.io.graphs.g2o_lines import EDGE, FIX, VERTEX, TaggedRows, read_rows
from gridslam.io.output import write_atomically
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

__all__ = ["G2oGraph", "read_g2o", "write_g2o"]

_UPPER = [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]  # rows and columns of the six numbers of a symmetric matrix in a file
_FULL = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # which of those six each of the nine entries is
_SHOWN = 10  # ids in a message


@final
@dataclass(frozen=True, slots=True, eq=False)
class G2oGraph:
    """A pose graph and how a file names it.

    Attributes
    ----------
    graph : PoseGraph
        Pose 0 is the fixed vertex, the others follow in the file's order.
    ids : (N,) int64
        The file's names of the poses of `graph`.
    order : (N,) int64
        Places in `graph` of the vertices in the file's order.
    skipped : dict
        How many lines of each unknown tag were passed over.
    """

    graph: PoseGraph
    ids: IntArray
    order: IntArray
    skipped: dict[str, int]

    @property
    def edge_ids(self) -> IntArray:
        """The file's names (M, 2) of the two poses that each edge joins."""
        return self.ids[self.graph.edges]


def read_g2o(path: str | Path, *, skip_unknown: bool = False) -> G2oGraph:
    """Read a planar pose graph; plain text, gzip or bzip2; lines in any order, those that begin with # are left out.

    The vertex that a FIX line names is pose 0, else the first vertex of the file. Edges between consecutive ids are
    taken for odometry and trusted. Headings are brought to [-pi, pi).

    Parameters
    ----------
    path : str or Path
        The file.
    skip_unknown : bool
        Whether lines of other tags are passed over and counted.

    Raises
    ------
    InputError
        With the line, where one is malformed or its tag unknown, a vertex is there twice, an edge or FIX names a vertex
        that is not there, an edge joins a vertex to itself or its information matrix is not positive definite, more
        than one vertex is fixed, or a vertex is not connected to the fixed one; without, where the file cannot be read
        or has no vertex.
    """
    tables, skipped = read_rows(path, skip_unknown)
    vertices, edges = tables[VERTEX], tables[EDGE]
    rows = _vertex_rows(path, vertices)
    fixed = _fixed_row(path, tables[FIX], rows)
    order = np.insert(np.arange(1, len(rows)), fixed, 0)
    ids, poses = np.empty(len(rows), np.int64), np.empty((len(rows), 3))
    ids[order], poses[order] = vertices.ids[:, 0], vertices.values
    pairs = order[_edge_rows(path, edges, rows)]
    apart = np.abs(edges.ids[:, 1] - edges.ids[:, 0])
    information = _information(path, edges)
    poses[:, 2] = wrap(poses[:, 2])
    measurements = np.column_stack([edges.values[:, :2], wrap(edges.values[:, 2])])
    # Built directly: what PoseGraph.of checks has been checked, with the lines.
    graph = PoseGraph(poses, pairs, measurements, information, apart == 1)
    _check_connected(path, pairs, order, vertices)
    return G2oGraph(graph, ids, order, skipped)


def write_g2o(path: str | Path, graph: PoseGraph, ids: ArrayLike | None = None, order: ArrayLike | None = None) -> None:
    """Write a pose graph, its pose 0 fixed; every number is written so that it is read back exactly.

    Parameters
    ----------
    path : str or Path
        The file, plain text; written atomically.
    graph : PoseGraph
        The poses and what was measured. Which edges are trusted has no place in the file: see `read_g2o`.
    ids : (N,) int, optional
        Names of the poses, >= 0 and all different; their places if not given.
    order : (N,) int, optional
        Places of the poses in the order in which they are written, by default their own.

    Raises
    ------
    ArgumentError
        `ids` are not N different ones >= 0, or `order` is no permutation of the places.
    OutputError
        The file cannot be written.
    """
    places = np.arange(len(graph.poses))
    names = places if ids is None else np.asarray(ids, np.int64)
    written = places if order is None else np.asarray(order, np.int64)
    if names.shape != places.shape or len(np.unique(names)) != len(places) or names.min() < 0:
        raise ArgumentError("ids", f"{len(places)} different ids >= 0", names.tolist())
    if not np.array_equal(np.sort(written), places):
        raise ArgumentError("order", f"a permutation of the places 0 to {len(places) - 1}", written.tolist())
    edges = np.concatenate([graph.measurements, graph.information[:, _UPPER[0], _UPPER[1]]], axis=1)
    lines = _lines(VERTEX, names[written, None], graph.poses[written])
    lines.insert(int(np.flatnonzero(written == 0)[0]) + 1, f"{FIX} {names[0]}\n")  # after its vertex
    with write_atomically(path) as aside, aside.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(lines)
        file.writelines(_lines(EDGE, names[graph.edges], edges))


def _lines(tag: str, ids: IntArray, values: FloatArray) -> list[str]:
    rows = zip(ids.tolist(), values.tolist(), strict=True)
    return [f"{tag} {' '.join(map(repr, [*names, *numbers]))}\n" for names, numbers in rows]


def _vertex_rows(path: str | Path, vertices: TaggedRows) -> dict[int, int]:
    """Which vertex of the file has an id."""
    rows: dict[int, int] = {}
    for row, name in enumerate(vertices.ids[:, 0].tolist()):
        if name in rows:
            problem = f"expected each vertex once, got {name} again, which line {vertices.lines[rows[name]]} has"
            raise InputError(path, problem, vertices.lines[row])
        rows[name] = row
    if not rows:
        raise InputError(path, f"expected a vertex ({VERTEX}), got none")
    return rows


def _fixed_row(path: str | Path, fixes: TaggedRows, rows: dict[int, int]) -> int:
    """Which vertex of the file is fixed."""
    names = fixes.ids[:, 0].tolist()
    for name, line in zip(names, fixes.lines, strict=True):
        if name not in rows:
            raise InputError(path, f"expected a vertex to fix, got {name}, which is not there", line)
        if name != names[0]:
            raise InputError(path, f"expected one fixed vertex, got {name} after {names[0]}", line)
    return rows[names[0]] if names else 0


def _edge_rows(path: str | Path, edges: TaggedRows, rows: dict[int, int]) -> IntArray:
    """Which vertices of the file (M, 2) the edges join."""
    ends = np.array([rows.get(name, -1) for name in edges.ids.ravel().tolist()], np.int64).reshape(-1, 2)
    if len(missing := np.argwhere(ends < 0)):
        edge, end = missing[0]
        problem = f"expected an edge between vertices, got vertex {edges.ids[edge, end]}, which is not there"
        raise InputError(path, problem, edges.lines[edge])
    if len(loops := np.flatnonzero(ends[:, 0] == ends[:, 1])):
        problem = f"expected an edge between two vertices, got one from {edges.ids[loops[0], 0]} to itself"
        raise InputError(path, problem, edges.lines[loops[0]])
    return ends


def _information(path: str | Path, edges: TaggedRows) -> FloatArray:
    """Information matrices (M, 3, 3)."""
    information = edges.values[:, 3:][:, _FULL].reshape(-1, 3, 3)
    least = np.linalg.eigvalsh(information)[:, 0]
    if len(bad := np.flatnonzero(~(least > 0))):
        problem = f"expected a positive definite information matrix, got one with the eigenvalue {least[bad[0]]:g}"
        raise InputError(path, problem, edges.lines[bad[0]])
    return information


def _check_connected(path: str | Path, pairs: IntArray, order: IntArray, vertices: TaggedRows) -> None:
    """Walk from pose 0 along the edges; each pose must be met."""
    neighbours: list[list[int]] = [[] for _ in order]
    for a, b in pairs.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    reached, ahead = np.zeros(len(order), np.bool_), [0]
    reached[0] = True
    while ahead:
        for place in neighbours[ahead.pop()]:
            if not reached[place]:
                reached[place] = True
                ahead.append(place)
    if len(lonely := np.flatnonzero(~reached[order])):
        names = vertices.ids[lonely, 0]
        shown = " ".join(map(str, names[:_SHOWN])) + (" ..." if len(names) > _SHOWN else "")
        fixed = vertices.ids[np.flatnonzero(order == 0)[0], 0]
        problem = f"expected edges from vertex {fixed} to all others, {len(names)} cannot be reached: {shown}"
        raise InputError(path, problem, vertices.lines[lonely[0]])
