"""Edits of a pose graph by hand: closures are rejected and added, and after each edit the graph is solved again."""

from __future__ import annotations

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
from gridslam.io.text import compute_digest
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

EDITED_GRAPH: Final = "graph_edited.g2o"


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
    whenever that is read. The solved graph is written to `graph_edited.g2o`; the graph itself stays as it is.

    Parameters
    ----------
    folder : Path
        OUT of a command that writes `graph.g2o`.
    sessions : sequence of Path
        Session files, one of which is the graph's.

    Raises
    ------
    InputError
        The graph or a session cannot be read, or no session has the key scans of the graph.
    """

    def __init__(self, folder: Path, sessions: Sequence[Path]) -> None:
        """Read the graph, and make the saved edits."""
        self._folder = folder
        self._source = read_g2o(folder / "graph.g2o")
        self._session, self._digest, self._saved, self._piece = self._find_session(sessions)
        self._now = self._solve([*self._saved.edits])

    def _find_session(self, sessions: Sequence[Path]) -> tuple[Path, str, SavedSession, MapPiece]:
        """Return the first session that has the key scans of the graph, its digest, content and newest piece."""
        for session in sessions:
            digest = compute_digest(session)
            saved = read_session(session, makes_edits=False)
            if saved.newest is not None and len(saved.newest) == len(self._source.graph.poses):
                return session, digest, saved, saved.newest
        raise InputError(self._folder, "expected a session of its graph, with the scans (map --save), got none")

    @property
    def results(self) -> StaticView:
        """The graph and the map as they are now."""
        return self._now.view

    def reject(self, pair: object) -> None:
        """Reject the edges between two poses [from, to], counted from 0, and those beside them.

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

    def look(self, number: object) -> Overlay:
        """Return both scans of one of the edges that are listed, one on the other."""
        listed = self.results.status(0, 0.0)["residuals"]
        if not (isinstance(number, int) and 0 <= number < len(listed)):
            raise ArgumentError("look", f"one of {len(listed)} edges", number)
        from_, to = listed[number][:2]
        edge = int(np.flatnonzero((self._now.graph.edges == (from_, to)).all(axis=1))[0])
        measured = self._now.graph.measurements[edge]
        mapper = self._saved.configuration.mapper
        score = score_placed(self._piece.scans, self._now.graph.poses, mapper, (from_, to), measured)
        return self._lay((from_, to), score, measured)

    def grab(self, place: object) -> Overlay:
        """Return the key scan nearest to a place [x, y]."""
        _, key = self._find(place)
        ends = self._piece.scans.key(key).ends.astype(np.float32)
        return Overlay((key, key), None, NO_POINTS, ends, self._now.graph.poses[key])

    def put(self, from_: object, to: object) -> Overlay:
        """Return the key scan nearest to a place [x, y], matched where it was put, to the map of another time.

        Raises ArgumentError where the robot was never near.
        """
        start, key = self._find(from_)
        end, _ = self._find(to)
        poses = self._now.graph.poses
        placed = poses[key] + np.append(end - start, 0.0)
        proposed, score = match_placed(self._piece.scans, poses, self._saved.configuration.mapper, key, placed)
        return self._lay(proposed.pair, score, proposed.measurement)._replace(proposed=proposed)

    def _find(self, place: object) -> tuple[FloatArray, int]:
        """Return a place [x, y] as an array, and the key scan that is nearest to it."""
        at = np.array(place, np.float64)
        if at.shape != (2,) or not np.isfinite(at).all():
            raise ArgumentError("put", "a place of two finite numbers", place)
        return at, int(np.hypot(*(self._now.graph.poses[:, :2] - at).T).argmin())

    def _lay(self, pair: tuple[int, int], score: float, measured: FloatArray) -> Overlay:
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
        constraints = self._piece.graph.constraints
        by_hand = {tuple(sorted(c.pair)) for c in constraints if c.source is ConstraintSource.BY_HAND}
        edges = np.sort(self._source.graph.edges, axis=1).tolist()
        return np.array([1 if tuple(edge) in by_hand else KEY_SCANS_PER_SUBMAP for edge in edges], np.int64)

    def _draw(self, poses: FloatArray) -> OccupancyGrid:
        """Return the map of the key scans at poses (T, 3)."""
        maps = self._saved.configuration.mapper.empty(1)
        insert_key_scans(maps, self._piece.scans, range(len(poses)), poses, self._piece.graph)
        return maps.tiled(0).whole()

    def _save(self, solved: _Solved) -> None:
        """Save the edits and the graph that they have made; neither where one of them cannot be."""
        source = self._source
        if compute_digest(self._session) != self._digest:
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
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        write_session(self._session, replace(self._saved, edits=tuple(edits), written=now, version=__version__))
        self._digest = compute_digest(self._session)


def _select(graph: PoseGraph, kept: NDArray[np.bool_]) -> PoseGraph:
    """Return the graph with some of its measurements (M,)."""
    names = "edges", "measurements", "information", "trusted"
    return replace(graph, **{name: getattr(graph, name)[kept] for name in names})


def _append(graph: PoseGraph, added: Constraint) -> PoseGraph:
    """Return the graph with another measurement."""
    more = {"edges": added.pair, "measurements": added.measurement, "information": added.information, "trusted": True}
    return replace(graph, **{name: np.append(getattr(graph, name), [value], axis=0) for name, value in more.items()})
