"""gridslam align."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.cli.options import name_option
from gridslam.cli.output import open_output, print_result, warn
from gridslam.errors import InputError
from gridslam.io.maps import write_map
from gridslam.plan.alignment import Alignment, align_points, align_walls, fit_pairs
from gridslam.plan.drawn_plans import SUFFIXES, draw_aligned, read_drawn_plan
from gridslam.plan.source import MapSource, read_source
from gridslam.plan.surfaces import SurfacePoints
from gridslam.types import FloatArray

_NAMES = "align.json", "align.png", "map.yaml", "map.pgm"
_LEAST_SHARE = 0.3
"""Of a map's surfaces that must lie on the plan: people draw less than a laser sees."""


def align_to_folder(
    source: Path,
    floor: str | None,
    plan: Path,
    out: Path,
    pairs: FloatArray,
    unit_m: float | None,
    by_pairs: bool,
    as_json: bool,
) -> None:
    """Align a map with a plan, write it to a folder and print a summary."""
    with open_output(out, _NAMES) as folder:
        with name_option(floor="--floor"):
            given = read_source(source, warn, floor)
        alignment, left, points, unit_m = _align(given, source, plan, pairs, unit_m, by_pairs)
        write_map(folder.file("map.yaml"), given.grid, alignment.pose, alignment.scale)
        draw_aligned(given.grid, alignment, points).save(folder.file("align.png"), compress_level=3)
        document = {
            "schema": "gridslam.align/1",
            "source": str(source),
            "plan": str(plan),
            "pairs_left_m": left.tolist(),
            "map_in_plan": alignment.pose.tolist(),
            "scale": alignment.scale,
            "unit_m": unit_m,
            "walls_in_common": None if by_pairs else alignment.share,
            "residual_m": alignment.residual_m,
        }
        folder.write_json("align.json", document)
    print_result(document, _summarize(document, out), as_json)


def _align(
    given: MapSource, source: Path, plan: Path, pairs: FloatArray, unit_m: float | None, by_pairs: bool
) -> tuple[Alignment, FloatArray, SurfacePoints, float]:
    """Align a map with a plan, in the plan's metres; return also the pairs' residuals, the walls and the unit."""
    drawn = read_drawn_plan(plan) if plan.suffix.lower() in SUFFIXES else None
    if drawn is None and unit_m is not None:
        raise InputError(plan, "expected no --unit with a map, which is in m")
    unit_m = unit_m or (1.0 if drawn is None else drawn.unit_m)
    there = pairs[:, 2:] if drawn is None else drawn.turn_up(pairs[:, 2:])
    if unit_m is None and not len(pairs):
        raise InputError(
            plan, "expected a plan with a scale: state --unit METRES of its pixels or units, or two --pair"
        )
    unit_m = unit_m or 1.0 / fit_pairs(pairs[:, :2], there)[0].scale
    fixed = read_source(plan, warn).surfaces if drawn is None else drawn.surfaces(unit_m)
    moved = given.surfaces
    for path, points in ((source, moved), (plan, fixed)):
        if not len(points):
            raise InputError(path, "expected walls, got none")
    if len(pairs):
        guess, left = fit_pairs(pairs[:, :2], unit_m * there)
        found = guess if by_pairs else align_walls(moved, fixed, guess)
    else:
        found, left = align_walls(moved, fixed, align_points(moved, fixed, drawn is not None)), np.zeros(0)
    if by_pairs or found.share >= _LEAST_SHARE:
        return found, left, fixed, unit_m
    problem = f"expected a plan of what {source} shows, but {found.share:.0%} of its walls agree with it"
    raise InputError(plan, f"{problem}; --by-pairs aligns by pairs alone")


def _summarize(document: dict[str, Any], out: Path) -> Iterator[str]:
    left = document["pairs_left_m"]
    if left:
        yield f"{len(left)} pairs, left: {', '.join(f'{distance:.3f}' for distance in left)} m"
    x, y, heading = document["map_in_plan"]
    yield f"aligned: {x:.3f} m, {y:.3f} m, {np.rad2deg(heading):.3f} deg, scale {document['scale']:.4f}"
    if document["walls_in_common"] is not None:
        yield f"{document['walls_in_common']:.0%} of the walls agree, to {document['residual_m']:.3f} m"
    yield f"map in the plan's frame: {out / 'map.yaml'}; both: {out / 'align.png'}"
