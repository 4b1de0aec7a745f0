"""How true the drift model is: errors of tracked motion around loops, in its standard deviations.

python benchmarks/drift.py LOG ... [--out FILE]

A loop is a key scan and an older one near it, some way apart. Where the model alone expects the one, seen from the
other, is compared with where the final trajectory has it; a true model has 95 of 100 within two standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gridslam import open_log
from gridslam.config import Configuration
from gridslam.geometry.se2 import between, compose
from gridslam.slam.loop_closure.key_graph import KeyGraph, position_sigmas
from gridslam.types import FloatArray
from measure import make_parser, write_document
from report import table
from simulated import map_drive

_NEAR_M = 8.0
_APART_M = 40.0
_MOST_KEYS = 200


class Drift(NamedTuple):
    """Errors around loops: how many loops, those within two standard deviations, root mean squares over these."""

    loops: int
    position_within: float
    heading_within: float
    position_rms: float
    heading_rms: float


def judge(graph: KeyGraph, truth: FloatArray) -> Drift:
    """Compare what the increments of a graph leave uncertain with true poses (T, 3) of its key scans."""
    alone = KeyGraph()
    for tracked, variances in zip(graph.tracked, graph.variances, strict=True):
        alone.extend(tracked, tracked, variances)
    way, gaps, tracked = alone.driven_m(), alone.label_gaps(), np.array(alone.tracked)
    keys = np.arange(0, len(alone), -(-len(alone) // _MOST_KEYS))
    ratios = [np.empty((0, 2))]
    for key in keys.tolist():
        older = keys[(way[key] - way[keys] > _APART_M) & (gaps[keys] == gaps[key])]
        older = older[np.hypot(*(truth[older] - truth[key])[:, :2].T) < _NEAR_M]
        if not len(older):
            continue
        expected, covariances = alone.locate(key, older)
        missed = between(expected, between(truth[older], truth[key]))
        turned = compose(tracked[older], between(truth[older], truth[key])) - compose(tracked[older], expected)
        position = np.hypot(turned[:, 0], turned[:, 1]) / position_sigmas(covariances)
        ratios.append(np.column_stack([position, np.abs(missed[:, 2]) / np.sqrt(covariances[:, 2, 2])]))
    found = np.concatenate(ratios)
    if not len(found):
        return Drift(0, *[float("nan")] * 4)
    return Drift(len(found), *(found < 2).mean(axis=0).tolist(), *np.sqrt(np.square(found).mean(axis=0)).tolist())


def main(arguments: Sequence[str] | None = None) -> list[list[Any]]:
    """Print the table of some logs."""
    parser = make_parser(__doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG")
    given = parser.parse_args(arguments)
    rows: list[list[Any]] = []
    for log in given.logs:
        piece = map_drive(open_log(log), Configuration(), 0)[1].piece
        assert piece is not None
        rows.append([log.name, *judge(piece.graph, piece.poses)])
    head = ["log", "loops", "position within 2 sigma", "heading within 2 sigma", "rms position", "rms heading"]
    print(table(head, rows))
    logs = {name: Drift(*figures)._asdict() for name, *figures in rows}
    write_document(given.out, logs=logs)
    return rows


if __name__ == "__main__":
    main()
