"""gridslam align."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.cli.output import open_output, print_result, warn
from gridslam.errors import InputError
from gridslam.io.maps import write_map
from gridslam.plan.alignment import align_points, align_walls
from gridslam.plan.drawn_plans import SUFFIXES, draw_aligned, read_drawn_plan
from gridslam.plan.source import read_source

_NAMES = "align.json", "align.png", "map.yaml", "map.pgm"
_LEAST_SHARE = 0.3
"""Of a map's surfaces that must lie on the plan: people draw less than a laser sees."""


def align_to_folder(source: Path, plan: Path, out: Path, unit_m: float | None, as_json: bool) -> None:
    """Align a map with a plan, write it to a folder and print a summary."""
    with open_output(out, _NAMES) as folder:
        given = read_source(source, warn)
        moved, is_drawn = given.surfaces, plan.suffix.lower() in SUFFIXES
        if is_drawn:
            fixed = read_drawn_plan(plan, unit_m)
        elif unit_m is not None:
            raise InputError(plan, "expected no --unit with a map, which is in m")
        else:
            fixed, unit_m = read_source(plan, warn).surfaces, 1.0
        for path, points in ((source, moved), (plan, fixed)):
            if not len(points):
                raise InputError(path, "expected walls, got none")
        alignment = align_walls(moved, fixed, align_points(moved, fixed, is_drawn))
        if alignment.share < _LEAST_SHARE:
            problem = f"expected a plan of what {source} shows, but {alignment.share:.0%} of its walls agree with it"
            raise InputError(plan, problem)
        write_map(folder.file("map.yaml"), given.grid, alignment.pose, alignment.scale)
        draw_aligned(given.grid, alignment, fixed).save(folder.file("align.png"), compress_level=3)
        document = {
            "schema": "gridslam.align/1",
            "source": str(source),
            "plan": str(plan),
            "map_in_plan": alignment.pose.tolist(),
            "scale": alignment.scale,
            "unit_m": unit_m,
            "walls_in_common": alignment.share,
            "residual_m": alignment.residual_m,
        }
        folder.write_json("align.json", document)
    print_result(document, _summarize(document, out), as_json)


def _summarize(document: dict[str, Any], out: Path) -> Iterator[str]:
    x, y, heading = document["map_in_plan"]
    yield f"aligned: {x:.3f} m, {y:.3f} m, {np.rad2deg(heading):.3f} deg, scale {document['scale']:.4f}"
    yield f"{document['walls_in_common']:.0%} of the walls agree, to {document['residual_m']:.3f} m"
    yield f"map in the plan's frame: {out / 'map.yaml'}; both: {out / 'align.png'}"
