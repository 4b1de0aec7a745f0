"""Edits of a pose graph by hand: edges that are rejected, after each of which the graph is solved again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, final

import numpy as np

from gridslam import __version__
from gridslam.errors import ArgumentError, InputError
from gridslam.io.g2o import read_g2o, write_g2o
from gridslam.io.output import write_atomically
from gridslam.io.text import read_json
from gridslam.live.results import StaticView
from gridslam.slam.pose_graph.graph_slam import GraphSlam

__all__ = ["EDITED_GRAPH", "EDITS", "EDITS_SCHEMA", "EditedGraph"]

EDITS: Final = "graph_edits.json"
"""Name of the file of the edits in the folder of the graph."""
EDITED_GRAPH: Final = "graph_edited.g2o"
EDITS_SCHEMA: Final = "gridslam.graph_edits/1"


@final
class EditedGraph:
    """A pose graph without the edges that were rejected, solved again.

    Each edit is saved at once: the rejected edges in `graph_edits.json`, from which they are taken again the next time,
    and the solved graph in `graph_edited.g2o`. The file of the graph itself stays as it is.

    Parameters
    ----------
    folder : Path
        OUT of a command that writes `graph.g2o`.

    Attributes
    ----------
    results : StaticView
        The graph as it is now.

    Raises
    ------
    InputError
        The graph or its edits cannot be read.
    """

    def __init__(self, folder: Path) -> None:
        """Read the graph, and apply the saved edits."""
        self._folder = folder
        self._source = read_g2o(folder / "graph.g2o")
        self._rejected = self._read()
        self.results = self._solve(self._rejected)

    def edit(self, rejects: object) -> None:
        """Reject the edges between two poses [from, to], counted from 0; None takes the last rejection back.

        Raises
        ------
        ArgumentError
            There is no such edge that may be rejected, or nothing to take back.
        OutputError
            The edits cannot be saved.
        """
        if rejects is None:
            if not self._rejected:
                raise ArgumentError("edit", "a rejected edge", "none")
            edited = self._rejected[:-1]
        else:
            edited = [*self._rejected, self._check(rejects)]
        self.results = self._solve(edited)
        self._rejected = edited
        self._save()

    def _check(self, pair: object) -> tuple[int, int]:
        graph = self._source.graph
        may_go = {tuple(edge) for edge in graph.edges[~graph.trusted].tolist()}.difference(self._rejected)
        if not (isinstance(pair, list | tuple) and tuple(pair) in may_go):
            raise ArgumentError("edit", "two poses that an edge joins which is no odometry", pair)
        return int(pair[0]), int(pair[1])

    def _solve(self, rejected: list[tuple[int, int]]) -> StaticView:
        """Solve the graph without these edges; raises ArgumentError where they leave it in parts."""
        graph = self._source.graph
        left_out = set(rejected)
        kept = np.array([tuple(edge) not in left_out for edge in graph.edges.tolist()], np.bool_)
        left = replace(
            graph,
            edges=graph.edges[kept],
            measurements=graph.measurements[kept],
            information=graph.information[kept],
            trusted=graph.trusted[kept],
        )
        self._graph = GraphSlam().solve(left).graph if rejected else left
        view = StaticView(None, self._graph, self._source.is_landmark)
        view.add_status({"rejected": [list(pair) for pair in rejected]})
        return view

    def _read(self) -> list[tuple[int, int]]:
        path = self._folder / EDITS
        if not path.is_file():
            return []
        document = read_json(path)
        places = {int(name): place for place, name in enumerate(self._source.ids)}
        named = document.get("rejected")
        rejected: list[tuple[int, int]] = []
        for pair in named if isinstance(named, list) else [None]:
            if not (
                isinstance(pair, list) and len(pair) == 2 and all(type(name) is int and name in places for name in pair)
            ):
                raise InputError(path, f"rejected: expected pairs of vertices of graph.g2o, got {pair!r:.60}")
            rejected.append((places[pair[0]], places[pair[1]]))
        return rejected

    def _save(self) -> None:
        ids = self._source.ids
        document: dict[str, Any] = {
            "schema": EDITS_SCHEMA,
            "version": __version__,
            "rejected": [[int(ids[a]), int(ids[b])] for a, b in self._rejected],
        }
        write_g2o(self._folder / EDITED_GRAPH, self._graph, ids, self._source.order, self._source.is_landmark)
        with write_atomically(self._folder / EDITS) as path:
            path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
