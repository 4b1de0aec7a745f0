"""Edits of a pose graph by hand: closures are rejected and added, and after each edit the graph is solved again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam import __version__
from gridslam.errors import ArgumentError, InputError, OutputError
from gridslam.geometry.se2 import compose, transform_points
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.io.output import write_atomically
from gridslam.io.sessions.session_file import SavedSession, read_session, write_session
from gridslam.io.text import compute_digest, read_json
from gridslam.live.ancestry_tree import NO_POINTS, Float32Array
from gridslam.live.results import StaticView
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource
from gridslam.slam.loop_closure.graph_edits import GraphEdit, match_placed, score_placed
from gridslam.slam.loop_closure.key_graph import KEY_SCANS_PER_SUBMAP, join_near
from gridslam.slam.loop_closure.map_piece import MapPiece
from gridslam.slam.loop_closure.submaps import insert_key_scans
from gridslam.slam.pose_graph.graph_slam import GraphSlam
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray, OccupancyGrid

EDITS: Final = "graph_edits.json"
"""Name of the file of the edits in the folder of a graph without a session."""
EDITED_GRAPH: Final = "graph_edited.g2o"
EDITS_SCHEMA: Final = "gridslam.graph_edits/1"


@final
class Overlay(NamedTuple):
    """Two scans, one on the other.

    Attributes
    ----------
    pair : (int, int)
        Their key scans.
    score : float or None
        Inlier ratio of the second one on the local map of the first one, [0, 1]; None of a single scan.
    older : (K, 2) float32, m
        End points of the first one, map frame.
    newer : (M, 2) float32, m
        End points of the second one, robot frame.
    pose : (3,) float64
        Pose of the second one, as it is measured from the first.
    proposed : Constraint, optional
        The measurement, where it is not in the graph.
    """

    pair: tuple[int, int]
    score: float | None
    older: Float32Array
    newer: Float32Array
    pose: FloatArray
    proposed: Constraint | None = None

    def describe(self) -> dict[str, Any]:
        """Return the values that the page shows beside the points."""
        score = None if self.score is None else round(self.score, 3)
        return {"pair": [*self.pair], "score": score, "proposed": self.proposed is not None}


@final
class _Solved(NamedTuple):
    """A graph with edits, which of its measurements (M,) may be rejected, and how the page shows it."""

    edits: list[GraphEdit]
    graph: PoseGraph
    may_go: NDArray[np.bool_]
    view: StaticView


@final
class EditedGraph:
    """A pose graph without the closures that were rejected and with those that were added, solved again.

    Each edit is saved at once: in the first of the sessions that has the key scans of the graph, in which it is made
    whenever that is read. Without one scans are not known, so that nothing is added, and what is rejected is saved in
    `graph_edits.json`. The solved graph is written to `graph_edited.g2o`; the graph itself stays as it is.

    Parameters
    ----------
    folder : Path
        OUT of a command that writes `graph.g2o`.
    sessions : sequence of Path
        Session files, one of which may be the graph's.

    Raises
    ------
    InputError
        The graph, its edits or a session cannot be read.
    """

    def __init__(self, folder: Path, sessions: Sequence[Path] = ()) -> None:
        """Read the graph, and make the saved edits."""
        self._folder = folder
        self._source = read_g2o(folder / "graph.g2o")
        self._session: Path | None = None
        self._digest = ""  # of the session, as it was read or saved here
        self._saved: SavedSession | None = None
        self._piece: MapPiece | None = None
        for session in sessions:
            digest = compute_digest(session)
            saved = read_session(session, makes_edits=False)
            if saved.newest is not None and len(saved.newest) == len(self._source.graph.poses):
                self._session, self._digest, self._saved, self._piece = session, digest, saved, saved.newest
                break
        edits = self._read() if self._saved is None else [*self._saved.edits]
        self._now = self._solve(edits)

    @property
    def has_scans(self) -> bool:
        """Whether there is a session of the graph, so that scans are seen and put on other places."""
        return self._piece is not None

    @property
    def results(self) -> StaticView:
        """The graph as it is now, and of a session the map."""
        return self._now.view

    def reject(self, pair: object) -> None:
        """Reject the edges between two poses [from, to], counted from 0; with scans, those beside them, too.

        Raises
        ------
        ArgumentError
            There is no such edge that may be rejected.
        OutputError
            The edits cannot be saved; nothing has changed.
        """
        edges = {tuple(edge) for edge in self._now.graph.edges[self._now.may_go].tolist()}
        if not (isinstance(pair, list | tuple) and tuple(pair) in edges):
            raise ArgumentError("edit", "two poses that an edge joins which is no odometry", pair)
        older, later = sorted(map(int, pair))
        self._change([*self._now.edits, GraphEdit((older, later))])

    def add(self, proposed: Constraint | None) -> None:
        """Add a closure; raises ArgumentError where none is proposed, and OutputError as `reject`."""
        if proposed is None:
            raise ArgumentError("edit", "a scan that was put on another place", "none")
        self._change([*self._now.edits, GraphEdit(proposed.pair, proposed)])

    def undo(self) -> None:
        """Take the last edit back; raises ArgumentError where there is none, and OutputError as `reject`."""
        if not self._now.edits:
            raise ArgumentError("edit", "an edit to take back", "none")
        self._change(self._now.edits[:-1])

    def look(self, number: object) -> Overlay | None:
        """Return both scans of one of the edges that are listed, one on the other; None where no scans are known."""
        listed = self.results.status(0, 0.0)["residuals"]
        if not (isinstance(number, int) and 0 <= number < len(listed)):
            raise ArgumentError("look", f"one of {len(listed)} edges", number)
        if self._piece is None or self._saved is None:
            return None
        from_, to = listed[number][:2]
        edge = int(np.flatnonzero((self._now.graph.edges == (from_, to)).all(axis=1))[0])
        measured = self._now.graph.measurements[edge]
        mapper = self._saved.configuration.mapper
        score = score_placed(self._piece.scans, self._now.graph.poses, mapper, (from_, to), measured)
        return self._lay((from_, to), score, measured)

    def grab(self, place: object) -> Overlay:
        """Return the key scan nearest to a place [x, y]; raises ArgumentError where no scans are known."""
        piece, _, key = self._find(place)
        ends = piece.scans.key(key).ends.astype(np.float32)
        return Overlay((key, key), None, NO_POINTS, ends, self._now.graph.poses[key])

    def put(self, from_: object, to: object) -> Overlay:
        """Return the key scan nearest to a place [x, y], matched where it was put, to the map of another time.

        Raises ArgumentError where no scans are known, or the robot was never near.
        """
        piece, start, key = self._find(from_)
        _, end, _ = self._find(to)
        poses = self._now.graph.poses
        assert self._saved is not None
        placed = poses[key] + np.append(end - start, 0.0)
        proposed, score = match_placed(piece.scans, poses, self._saved.configuration.mapper, key, placed)
        return self._lay(proposed.pair, score, proposed.measurement)._replace(proposed=proposed)

    def _find(self, place: object) -> tuple[MapPiece, FloatArray, int]:
        """Return the scans, a place [x, y] as an array, and the key scan that is nearest to it."""
        if self._piece is None:
            raise ArgumentError("put", "a session in the folder, whose scans can be matched", "none")
        at = np.array(place, np.float64)
        if at.shape != (2,) or not np.isfinite(at).all():
            raise ArgumentError("put", "a place of two finite numbers", place)
        return self._piece, at, int(np.hypot(*(self._now.graph.poses[:, :2] - at).T).argmin())

    def _lay(self, pair: tuple[int, int], score: float, measured: FloatArray) -> Overlay:
        assert self._piece is not None
        older, newer = (self._piece.scans.key(key).ends for key in pair)
        there = self._now.graph.poses[pair[0]]
        ends = transform_points(there, older).astype(np.float32)
        return Overlay(pair, score, ends, newer.astype(np.float32), compose(there, measured))

    def _change(self, edits: list[GraphEdit]) -> None:
        """Solve with these edits and save them; where either cannot be, all stays as it was."""
        solved = self._solve(edits)
        self._save(solved)
        self._now = solved

    def _solve(self, edits: list[GraphEdit]) -> _Solved:
        """Solve the graph with these edits."""
        graph = self._source.graph
        may_go = ~graph.trusted
        reach = self._find_reaches()  # of a rejection, to each of the edges
        for pair, added in edits:
            if added is None:
                kept = ~(join_near(graph.edges, pair, reach) & may_go)
                graph, may_go, reach = _select(graph, kept), may_go[kept], reach[kept]
            else:
                graph, may_go, reach = _append(graph, added), np.append(may_go, True), np.append(reach, 1)
        if edits:
            graph = GraphSlam().solve(graph).graph
        view = StaticView(self._draw(graph.poses), graph, self._source.is_landmark)
        view.add_status({
            "rejected": [[*edit.pair] for edit in edits if edit.added is None],
            "added": [[*edit.pair] for edit in edits if edit.added is not None],
        })  # fmt: skip
        return _Solved(edits, graph, may_go, view)

    def _find_reaches(self) -> IntArray:
        """Return how near, in key scans, a pair that is rejected takes each edge of the file (M,) with it.

        What a person has added goes only with its own pair, as in the session.
        """
        edges = self._source.graph.edges
        reaches = np.ones(len(edges), np.int64)
        if self._piece is not None:
            constraints = self._piece.graph.constraints
            by_hand = {tuple(sorted(c.pair)) for c in constraints if c.source is ConstraintSource.BY_HAND}
            others = [tuple(edge) not in by_hand for edge in np.sort(edges, axis=1).tolist()]
            reaches[others] = KEY_SCANS_PER_SUBMAP
        return reaches

    def _draw(self, poses: FloatArray) -> OccupancyGrid | None:
        """Return the map of the key scans at poses (T, 3); None where no scans are known."""
        if self._piece is None or self._saved is None:
            return None
        maps = self._saved.configuration.mapper.empty(1)
        insert_key_scans(maps, self._piece.scans, range(len(poses)), poses, self._piece.graph)
        return maps.tiled(0).whole()

    def _read(self) -> list[GraphEdit]:
        path = self._folder / EDITS
        if not path.is_file():
            return []
        places = {int(name): place for place, name in enumerate(self._source.ids)}
        named = read_json(path).get("rejected")
        edits: list[GraphEdit] = []
        for pair in named if isinstance(named, list) else [None]:
            if not (
                isinstance(pair, list) and len(pair) == 2 and all(type(name) is int and name in places for name in pair)
            ):
                raise InputError(path, f"rejected: expected pairs of vertices of graph.g2o, got {pair!r:.60}")
            edits.append(GraphEdit((places[pair[0]], places[pair[1]])))
        return edits

    def _save(self, solved: _Solved) -> None:
        """Save the edits and the graph that they have made; neither where one of them cannot be."""
        source = self._source
        if self._session is not None and compute_digest(self._session) != self._digest:
            raise InputError(self._session, "another program has saved this session since: begin the view again")
        is_saved = False
        try:
            with write_atomically(self._folder / EDITED_GRAPH) as path:
                write_g2o(path, solved.graph, source.ids, source.order, source.is_landmark)
                self._save_edits(solved.edits)
                is_saved = True
        except OutputError:
            if is_saved:
                self._save_edits(self._now.edits)
            raise

    def _save_edits(self, edits: list[GraphEdit]) -> None:
        if self._saved is not None and self._session is not None:
            now = datetime.now(timezone.utc).isoformat(timespec="seconds")
            write_session(self._session, replace(self._saved, edits=tuple(edits), written=now, version=__version__))
            self._digest = compute_digest(self._session)
            return
        rejected = [[int(self._source.ids[key]) for key in edit.pair] for edit in edits]
        document = {"schema": EDITS_SCHEMA, "version": __version__, "rejected": rejected}
        with write_atomically(self._folder / EDITS) as path:
            path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _select(graph: PoseGraph, kept: NDArray[np.bool_]) -> PoseGraph:
    """Return the graph with some of its measurements (M,)."""
    names = "edges", "measurements", "information", "trusted"
    return replace(graph, **{name: getattr(graph, name)[kept] for name in names})


def _append(graph: PoseGraph, added: Constraint) -> PoseGraph:
    """Return the graph with another measurement."""
    more = {"edges": added.pair, "measurements": added.measurement, "information": added.information, "trusted": True}
    return replace(graph, **{name: np.append(getattr(graph, name), [value], axis=0) for name, value in more.items()})
