"""gridslam plan."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.cli.output import open_output, print_result, warn
from gridslam.errors import InputError
from gridslam.plan.drawing import draw_plan
from gridslam.plan.exports import WorldOrigin, write_dxf, write_geojson
from gridslam.plan.floor_plan import FloorPlan, make_plan
from gridslam.plan.sheet import write_pdf, write_png, write_svg
from gridslam.plan.source import read_source

__all__ = ["plan_to_folder"]

_NAMES = "plan.svg", "plan.pdf", "plan.png", "plan.dxf", "plan.geojson", "plan.json"


def plan_to_folder(
    source: Path, out: Path, scale: int, straighten: bool, origin: tuple[float, float, float] | None, as_json: bool
) -> None:
    """Make a floor plan, write it to a folder and print a summary."""
    with open_output(out, _NAMES) as folder:
        given = read_source(source, warn)
        plan = make_plan(given.grid, given.points)
        if not plan.walls:
            raise InputError(source, "expected a map with walls, got one without a straight surface of 0.25 m")
        shown = plan.straighten() if straighten else plan
        sheet = draw_plan(shown, given.name, scale)
        write_svg(folder.file("plan.svg"), sheet)
        write_pdf(folder.file("plan.pdf"), sheet)
        write_png(folder.file("plan.png"), sheet)
        write_dxf(folder.file("plan.dxf"), shown)
        world = None if origin is None else WorldOrigin(*origin)
        write_geojson(folder.file("plan.geojson"), shown if world is None else plan, given.name, world)
        document = _describe(source, shown, scale, "cells" if given.points is None else "end points")
        folder.write_json("plan.json", document)
    print_result(document, _summarize(shown, document, out), as_json)


def _describe(source: Path, plan: FloorPlan, scale: int, made_from: str) -> dict[str, Any]:
    low, high = plan.bounds.tolist()
    return {
        "schema": "gridslam.plan/1",
        "source": str(source),
        "made_from": made_from,
        "scale": scale,
        "bounds_m": [low, high],
        "dominant_deg": float(np.rad2deg(plan.dominant_rad)),
        "turned_deg": float(np.rad2deg(plan.turned_rad)),
        "walls": len(plan.walls),
        "walls_length_m": sum(wall.length_m for wall in plan.walls),
        "doors": [
            {"kind": o.kind, "width_m": o.width_m, "middle_m": o.ends.mean(axis=0).tolist()} for o in plan.openings
        ],
        "rooms": [{"name": r.name, "area_m2": r.area_m2, "complete": not len(r.unknown)} for r in plan.rooms],
        "furniture": len(plan.furniture),
    }


def _summarize(plan: FloorPlan, document: dict[str, Any], out: Path) -> Iterator[str]:
    thick = sum(wall.thickness_m is not None for wall in plan.walls)
    yield (
        f"{len(plan.walls)} walls, {document['walls_length_m']:.0f} m, {thick} of them with their thickness, "
        f"from {document['made_from']}; most run at {document['dominant_deg']:.2f} deg"
    )
    widths = sorted(opening.width_m for opening in plan.openings)
    yield f"{len(widths)} doors and openings" + (f", {widths[0]:.2f} to {widths[-1]:.2f} m wide" if widths else "")
    yield f"{len(plan.rooms)} rooms, {sum(room.area_m2 for room in plan.rooms):.0f} m\u00b2"
    yield f"plan, 1:{document['scale']}: {out / 'plan.png'}, {out / 'plan.svg'}, {out / 'plan.pdf'}"
    yield f"for other programs: {out / 'plan.dxf'}, {out / 'plan.geojson'}"
