"""Planar pose graphs as text: g2o's lines VERTEX_SE2, EDGE_SE2, FIX, and of landmarks; TORO's VERTEX2 and EDGE2."""

from __future__ import annotations

import textwrap
from array import array
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.angles import wrap_headings
from gridslam.io.measurement import FARTHEST_M
from gridslam.io.output import write_atomically
from gridslam.io.tables import check_rows, parse_tagged, symmetric_of_upper, upper_of_symmetric
from gridslam.io.text import read_numbered_lines
from gridslam.slam.pose_graph.linear import find_parts, initial_guess
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

_VERTEX = "VERTEX_SE2"
_EDGE = "EDGE_SE2"
_FIX = "FIX"
_POINT = "VERTEX_XY"
_POINT_EDGE = "EDGE_SE2_XY"
_TORO_VERTEX = "VERTEX2"
_TORO_EDGE = "EDGE2"
_IDS = {_VERTEX: "id", _EDGE: "from to", _FIX: "id", _POINT: "id", _POINT_EDGE: "from to"}
_IDS |= {_TORO_VERTEX: "id", _TORO_EDGE: "from to"}
_VALUES = {
    _VERTEX: "x y theta",
    _EDGE: "x y theta I_xx I_xy I_xt I_yy I_yt I_tt",
    _FIX: "",
    _POINT: "x y",
    _POINT_EDGE: "x y I_xx I_xy I_yy",
    _TORO_VERTEX: "x y theta",
    _TORO_EDGE: "x y theta I_xx I_xy I_yy I_tt I_xt I_yt",
}
_SAME_AS = {_POINT: _VERTEX, _POINT_EDGE: _EDGE, _TORO_VERTEX: _VERTEX, _TORO_EDGE: _EDGE}
"""The tag as which lines of another tag are kept: a landmark is a pose whose heading is nearly free."""
_TAGS = {(1, False): _VERTEX, (1, True): _POINT, (2, False): _EDGE, (2, True): _POINT_EDGE}
_FREE_HEADING = 1e-9  # information about a landmark's heading, of that about its place: it moves nothing
_FIELDS = {tag: f"{ids} {_VALUES[tag]}".strip() for tag, ids in _IDS.items()}
_MOST = 1e18  # standard deviations of a nanometre
_LEAST = 1e-18
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
    is_landmark : (N,) bool
        Which poses of `graph` are landmarks, whose headings mean nothing.
    """

    graph: PoseGraph
    ids: IntArray
    order: IntArray
    skipped: dict[str, int]
    is_landmark: NDArray[np.bool_]

    @property
    def edge_ids(self) -> IntArray:
        """The file's names (M, 2) of the two poses that each edge joins."""
        return self.ids[self.graph.edges]


def read_g2o(path: str | Path, *, skip_unknown: bool = False) -> G2oGraph:
    """Read a planar pose graph; plain text, gzip or bzip2; lines in any order, those that begin with # are left out.

    TORO's VERTEX2 and EDGE2 are read as VERTEX_SE2 and EDGE_SE2. Landmarks, VERTEX_XY with EDGE_SE2_XY, become poses
    with a heading of hardly any information.

    The vertex that a FIX line names is pose 0, else the first vertex of the file. Of a file that has edges alone, the
    vertices are what the edges name, in the order in which they do; the fixed one is at the origin, and the others are
    where chordal relaxation of the edges puts them (`initial_guess`). Edges between consecutive ids are
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
        or has neither vertices nor edges.
    """
    tables, skipped = _read_lines(path, skip_unknown)
    edges = _merge(tables, _EDGE)
    landmarks = np.concatenate([tables[_POINT].ids[:, 0], tables[_POINT_EDGE].ids[:, 1]])
    vertices = _merge(tables, _VERTEX)
    is_guessed = not vertices.lines and len(edges.lines) > 0
    vertices = _name_vertices(edges) if is_guessed else vertices
    names = vertices.ids[:, 0].tolist()
    row_of = dict(zip(reversed(names), reversed(range(len(names))), strict=True))  # the first row of each name
    _check_vertices(path, vertices, row_of)
    fixed = _fixed_row(path, tables[_FIX], row_of)
    pairs = _edge_rows(path, edges, row_of)
    information = symmetric_of_upper(edges.values[:, 3:])
    least = np.linalg.eigvalsh(information)[:, 0]
    problem = "expected a positive definite information matrix, got one with the eigenvalue"
    check_rows(path, edges.lines, least >= _LEAST, lambda edge: f"{problem} {least[edge]:g}")
    _check_connected(path, vertices, pairs, fixed)
    order = np.insert(np.arange(1, len(names)), fixed, 0)
    by_place = np.argsort(order)
    graph = PoseGraph(  # built directly: what PoseGraph.of checks has been checked, with the lines
        wrap_headings(vertices.values[by_place]),
        order[pairs],
        wrap_headings(edges.values[:, :3]),
        information,
        (np.abs(edges.ids[:, 1] - edges.ids[:, 0]) == 1) & ~np.isin(edges.ids[:, 1], landmarks),
    )
    if is_guessed:
        try:
            graph = graph.with_poses(wrap_headings(initial_guess(graph)))
        except ArgumentError as error:
            raise InputError(path, str(error)) from None
    ids = vertices.ids[by_place, 0]
    return G2oGraph(graph, ids, order, skipped, np.isin(ids, landmarks))


def write_g2o(
    path: str | Path,
    graph: PoseGraph,
    ids: ArrayLike | None = None,
    order: ArrayLike | None = None,
    is_landmark: ArrayLike | None = None,
) -> None:
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
    is_landmark : (N,) bool, optional
        Which poses are written as landmarks, and the edges to them as their measurements; none if not given.

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
    edges = np.concatenate([graph.measurements, upper_of_symmetric(graph.information)], axis=1)
    points = np.zeros(len(places), np.bool_) if is_landmark is None else np.asarray(is_landmark, np.bool_)
    lines = [_format(points[place], names[place, None], graph.poses[place]) for place in written]
    lines.insert(int(np.flatnonzero(written == 0)[0]) + 1, f"{_FIX} {names[0]}\n")  # after its vertex
    with write_atomically(path) as aside, aside.open("w", encoding="ascii", newline="\n") as file:
        file.writelines(lines)
        file.writelines(map(_format, points[graph.edges[:, 1]], names[graph.edges], edges))


def _format(is_landmark: bool, ids: IntArray, values: FloatArray) -> str:
    """Return the line of a vertex (one id) or an edge (two)."""
    tag = _TAGS[len(ids), bool(is_landmark)]
    kept = values[[0, 1, 3, 4, 6][: len(_VALUES[tag].split())]] if is_landmark else values
    return f"{tag} {' '.join(map(repr, [*ids.tolist(), *kept.tolist()]))}\n"


class _Rows(NamedTuple):
    """Lines of one tag: ids (K, 1 or 2) int64, numbers (K, V) float64, line numbers (K,)."""

    ids: IntArray
    values: FloatArray
    lines: list[int]


def _read_lines(path: str | Path, skip_unknown: bool) -> tuple[dict[str, _Rows], dict[str, int]]:
    """Read the lines of each known tag, and count those of each unknown one."""
    ids = {tag: array("q") for tag in _FIELDS}
    values = {tag: array("d") for tag in _FIELDS}
    lines: dict[str, list[int]] = {tag: [] for tag in _FIELDS}
    skipped = Counter[str]()
    for number, line in read_numbered_lines(path):
        tag = line.split(None, 1)[0]
        if tag in _FIELDS:
            own_ids, numbers = parse_tagged(path, number, line, _IDS[tag], _VALUES[tag])
            ids[tag].extend(own_ids)
            values[tag].extend(numbers)
            lines[tag].append(number)
        elif skip_unknown:
            skipped[tag] += 1
        else:
            problem = f"expected the tag {', '.join(_FIELDS)}, got {textwrap.shorten(tag, 40)!r}"
            raise InputError(path, f"{problem} (--skip-unknown passes over such lines and counts them)", number)
    return {tag: _table(path, tag, ids[tag], values[tag], lines[tag]) for tag in _FIELDS}, dict(skipped)


def _table(path: str | Path, tag: str, ids: array[int], values: array[float], lines: list[int]) -> _Rows:
    width = len(_VALUES[tag].split())
    names = np.array(ids).reshape(len(lines), len(_IDS[tag].split()))
    rows = _Rows(names, np.array(values).reshape(len(lines), width), lines)
    is_information = np.array([name.startswith("I_") for name in _VALUES[tag].split()], np.bool_)
    possible = (np.abs(rows.values) <= np.where(is_information, _MOST, FARTHEST_M)).all(axis=1)
    most = f"numbers up to {FARTHEST_M:g} m and rad" + f", information up to {_MOST:g}" * bool(is_information.any())
    expected = f"expected {most} for {tag} {_FIELDS[tag]}"
    check_rows(path, lines, possible, lambda row: f"{expected}, got {' '.join(f'{x:g}' for x in rows.values[row])}")
    return rows


def _merge(tables: dict[str, _Rows], tag: str) -> _Rows:
    """Return the lines that are kept as those of a tag, in the order of the file."""
    parts = [_as(other, tables[other]) for other in _FIELDS if _SAME_AS.get(other, other) == tag]
    lines = [line for part in parts for line in part.lines]
    order = np.argsort(np.array(lines, np.int64))
    ids, values = (np.concatenate([part[k] for part in parts])[order] for k in (0, 1))
    return _Rows(ids, values, [lines[k] for k in order.tolist()])


def _as(tag: str, rows: _Rows) -> _Rows:
    """Return the rows with the columns of the tag as which they are kept."""
    values = rows.values
    nothing = np.zeros(len(values))
    if tag == _POINT:
        values = np.column_stack([values, nothing])
    elif tag == _POINT_EDGE:
        x, y, xx, xy, yy = values.T
        values = np.column_stack([x, y, nothing, xx, xy, nothing, yy, nothing, _FREE_HEADING * 0.5 * (xx + yy)])
    elif tag == _TORO_EDGE:
        values = values[:, [0, 1, 2, 3, 4, 7, 5, 8, 6]]
    return rows._replace(values=values)


def _name_vertices(edges: _Rows) -> _Rows:
    """The vertices that edges name, in the order in which they do, at the origin; each on the line that does first."""
    names = edges.ids.ravel()
    first = np.sort(np.unique(names, return_index=True)[1])
    lines = [edges.lines[place] for place in (first // 2).tolist()]
    return _Rows(names[first, None], np.zeros((len(first), 3)), lines)


def _check_vertices(path: str | Path, vertices: _Rows, row_of: dict[int, int]) -> None:
    """Each vertex must be there once, and one at least."""
    if not row_of:
        raise InputError(path, f"expected vertices ({_VERTEX}) or edges ({_EDGE}), got none")
    names = vertices.ids[:, 0].tolist()
    first = np.array([row_of[name] == row for row, name in enumerate(names)])

    def describe(row: int) -> str:
        return f"expected each vertex once, got {names[row]} again, which line {vertices.lines[row_of[names[row]]]} has"

    check_rows(path, vertices.lines, first, describe)


def _fixed_row(path: str | Path, fixes: _Rows, row_of: dict[int, int]) -> int:
    """Return which vertex of the file is fixed."""
    names = fixes.ids[:, 0].tolist()
    for name, line in zip(names, fixes.lines, strict=True):
        if name not in row_of:
            raise InputError(path, f"expected a vertex to fix, got {name}, which is not there", line)
        if name != names[0]:
            raise InputError(path, f"expected one fixed vertex, got {name} after {names[0]}", line)
    return row_of[names[0]] if names else 0


def _edge_rows(path: str | Path, edges: _Rows, row_of: dict[int, int]) -> IntArray:
    """Return which vertices of the file (M, 2) the edges join."""
    ends = np.array([row_of.get(name, -1) for name in edges.ids.ravel().tolist()], np.int64).reshape(-1, 2)

    def describe_missing(edge: int) -> str:
        missing = edges.ids[edge][ends[edge] < 0][0]
        return f"expected an edge between vertices, got vertex {missing}, which is not there"

    def describe_loop(edge: int) -> str:
        return f"expected an edge between two vertices, got one from {edges.ids[edge, 0]} to itself"

    check_rows(path, edges.lines, (ends >= 0).all(axis=1), describe_missing)
    check_rows(path, edges.lines, ends[:, 0] != ends[:, 1], describe_loop)
    return ends


def _check_connected(path: str | Path, vertices: _Rows, pairs: IntArray, fixed: int) -> None:
    """Edges must lead from the fixed vertex to each other one."""
    part = find_parts(pairs, len(vertices.lines))
    apart = vertices.ids[part != part[fixed], 0]

    def describe(_: int) -> str:
        shown = " ".join(map(str, apart[:_SHOWN])) + (" ..." if len(apart) > _SHOWN else "")
        fixed_id = vertices.ids[fixed, 0]
        return f"expected edges from vertex {fixed_id} to all others, {len(apart)} cannot be reached: {shown}"

    check_rows(path, vertices.lines, part == part[fixed], describe)
