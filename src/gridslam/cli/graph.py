"""gridslam graph."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam import __version__
from gridslam.cli import find_start_s
from gridslam.cli.output import open_output, print_result, warn
from gridslam.errors import ArgumentError, InputError
from gridslam.io.g2o import G2oGraph, read_g2o, write_g2o
from gridslam.io.output import OutputFolder
from gridslam.io.text import compute_digest
from gridslam.pipeline import Stopwatch
from gridslam.slam.pose_graph.graph_slam import GraphSlam, GraphSolution
from gridslam.slam.pose_graph.robust import GraduatedNonConvexity
from gridslam.viz import draw_graph

GRAPH_SCHEMA = "gridslam.graph/2"

_GRAPH = "graph.g2o"
_PICTURE = "graph.png"
_MIN_WEIGHT = 0.5  # an edge of a smaller weight is rejected; robust estimation drives weights to 0 or 1
_MAX_LISTED = 10  # rejected edges in the summary


def graph_to_folder(
    file: Path, out: Path, robust: bool, no_guess: bool, skip_unknown: bool, max_iterations: int, as_json: bool
) -> None:
    """Solve a pose graph, write the results to a folder and print a summary."""
    watch = Stopwatch(find_start_s(), 0.0)
    solver = GraphSlam(
        first_guess="computed" if no_guess else "either",
        robust=GraduatedNonConvexity() if robust else None,
        max_iterations=max_iterations,
    )
    watch.lap("start")
    source = read_g2o(file, skip_unknown=skip_unknown)
    watch.lap("read")
    with open_output(out) as folder:
        try:
            solution = solver.solve(source.graph)
        except ArgumentError as error:
            raise InputError(file, str(error)) from None
        watch.lap("solve")
        rejected = solution.weights < _MIN_WEIGHT if robust else None
        document = _document(file, source, solver, solution, rejected, watch)
        _write(folder, source, solution, rejected, document, watch)
    if not solution.converged:
        warn(f"{file}: no convergence within --max-iterations {max_iterations}")
    print_result(document, _summarize(document, out), as_json)


def _document(
    file: Path,
    source: G2oGraph,
    solver: GraphSlam,
    solution: GraphSolution,
    rejected: NDArray[np.bool_] | None,
    watch: Stopwatch,
) -> dict[str, Any]:
    """Build the content of graph.json, except for the times of writing."""
    graph = source.graph
    document = {
        "schema": GRAPH_SCHEMA,
        "version": __version__,
        "input": {
            "path": str(file),
            "sha256": compute_digest(file),
            "vertices": len(graph.poses),
            "edges": len(graph.edges),
            "loop_closures": int((~graph.trusted & ~source.is_landmark[graph.edges[:, 1]]).sum()),
            "landmarks": int(source.is_landmark.sum()),
            "fixed": int(source.ids[0]),
            "skipped": source.skipped,
        },
        "first_guess": solver.first_guess,
        "robust": solver.robust is not None,
        "max_iterations": solver.max_iterations,
        "chi2_before": solution.chi2_before,
        "chi2_after": solution.chi2_after,
        "iterations": solution.iterations,
        "converged": solution.converged,
        "seconds": watch.stages["solve"][0],
    }
    if rejected is not None:
        document |= {"rejected": source.edge_ids[rejected].tolist(), "weights": np.round(solution.weights, 6).tolist()}
    return document


def _write(
    folder: OutputFolder,
    source: G2oGraph,
    solution: GraphSolution,
    rejected: NDArray[np.bool_] | None,
    document: dict[str, Any],
    watch: Stopwatch,
) -> None:
    """Write the files, and how long that took into the document."""
    write_g2o(folder.file(_GRAPH), solution.graph, source.ids, source.order, source.is_landmark)
    watch.lap("write")
    picture = draw_graph(
        solution.graph,
        rejected=rejected,
        title=Path(document["input"]["path"]).name,
        caption=_caption(document),
        ends=(str(source.ids[0]), str(source.ids[-1])),
    )
    picture.save(folder.file(_PICTURE), optimize=False)
    watch.lap("draw")
    document["time"] = watch.to_dict()
    folder.write_json("graph.json", document)


def _format_vertices(graph: dict[str, Any]) -> str:
    landmarks = graph["landmarks"]
    return f"{graph['vertices'] - landmarks} poses" + (f", {landmarks} landmarks" if landmarks else "")


def _caption(document: dict[str, Any]) -> list[str]:
    graph = document["input"]
    rejected = f", {len(document['rejected'])} rejected" if document["robust"] else ""
    return [
        f"{_format_vertices(graph)}, {graph['edges']} edges, {graph['loop_closures']} of them loop closures{rejected}",
        f"chi2 {document['chi2_before']:.6g} before, {document['chi2_after']:.6g} after",
        f"{document['iterations']} iterations in {document['seconds']:.3f} s: gridslam {__version__}",
    ]


def _summarize(document: dict[str, Any], out: Path) -> list[str]:
    """Format the summary."""
    graph = document["input"]
    rejected = document.get("rejected", [])
    lines = [
        f"{Path(graph['path']).name}: {_format_vertices(graph)}, {graph['edges']} edges, "
        f"{graph['loop_closures']} of them loop closures",
        f"chi2 {document['chi2_before']:.6g} before, {document['chi2_after']:.6g} after, "
        f"{document['iterations']} iterations in {document['seconds']:.3f} s",
        f"graph: {out / _GRAPH}, {out / _PICTURE}",
    ]
    if graph["skipped"]:
        counts = ", ".join(f"{count} {tag}" for tag, count in graph["skipped"].items())
        lines.insert(1, f"skipped lines: {counts}")
    if document["robust"]:
        some = ", ".join(f"{first} {second}" for first, second in rejected[:_MAX_LISTED])
        listed = (": " + some + (", ..." if len(rejected) > _MAX_LISTED else "")) if rejected else ""
        lines.insert(-1, f"rejected {len(rejected)} loop closures{listed}")
    return lines
