"""gridslam plan and changes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gridslam.cli.output import counted, open_output, print_result, warn
from gridslam.errors import InputError
from gridslam.plan.alignment import Alignment, align_points
from gridslam.plan.changes import Changes, describe_changes, find_changes, write_changes_png
from gridslam.plan.exports import write_geojson, write_svg
from gridslam.plan.floor_plan import FloorPlan, make_plan
from gridslam.plan.rooms import name_rooms
from gridslam.plan.source import read_source

_NAMES = "plan.svg", "plan.geojson", "plan.json"
_CHANGES_NAMES = "changes.png", "changes.json"
_LEAST_SHARE = 0.3
"""Of a map's surfaces that must lie on the other one's: two days of one building have more than half."""


def plan_to_folder(
    source: Path,
    out: Path,
    scale: int,
    as_json: bool,
) -> None:
    """Make a floor plan, write it to a folder and print a summary."""
    with open_output(out, _NAMES) as folder:
        given = read_source(source, warn)
        plan = make_plan(given.grid, given.points, given.path)
        plan = replace(plan, rooms=name_rooms(plan.rooms, given.names))
        if not plan.walls:
            raise InputError(source, "expected a map with walls, got one without a straight surface of 0.25 m")
        write_svg(folder.file("plan.svg"), plan, given.name, scale)
        write_geojson(folder.file("plan.geojson"), plan, given.name)
        document = _describe(source, plan, scale, "cells" if given.points is None else "end points")
        folder.write_json("plan.json", document)
    print_result(document, _summarize(plan, document, out), as_json)


def _describe(source: Path, plan: FloorPlan, scale: int, made_from: str) -> dict[str, Any]:
    return {
        "schema": "gridslam.plan/1",
        "source": str(source),
        "made_from": made_from,
        "scale": scale,
        "dominant_deg": float(np.rad2deg(plan.dominant_rad)),
        "walls": len(plan.walls),
        "walls_length_m": sum(wall.length_m for wall in plan.walls),
        "doors": [
            {"kind": o.kind, "width_m": o.width_m, "middle_m": o.ends.mean(axis=0).tolist()} for o in plan.openings
        ],
        "rooms": [
            {"name": r.name, "area_m2": r.area_m2, "complete": not len(r.unknown), "entered": r.is_entered}
            for r in plan.rooms
        ],
        "furniture": len(plan.furniture),
    }


def _summarize(plan: FloorPlan, document: dict[str, Any], out: Path) -> Iterator[str]:
    thick = sum(wall.thickness_m is not None for wall in plan.walls)
    yield (
        f"{counted(document['walls'], 'wall')}, {document['walls_length_m']:.0f} m, {thick} of them with their "
        f"thickness, from {document['made_from']}; most run at {document['dominant_deg']:.2f} deg"
    )
    widths = sorted(opening.width_m for opening in plan.openings)
    yield f"{len(widths)} doors and openings" + (f", {widths[0]:.2f} to {widths[-1]:.2f} m wide" if widths else "")
    looked_into = [room.area_m2 for room in plan.rooms if room.is_entered is False]
    area_m2 = sum(room.area_m2 for room in plan.rooms) - sum(looked_into)
    yield f"{counted(len(plan.rooms) - len(looked_into), 'room')}, {area_m2:.0f} m\u00b2" + (
        f"; {len(looked_into)} more that were only looked into, {sum(looked_into):.0f} m\u00b2" if looked_into else ""
    )
    yield f"plan, 1:{document['scale']}: {out / 'plan.svg'}"
    yield f"for other programs: {out / 'plan.geojson'}"


def changes_to_folder(first: Path, second: Path, out: Path, same_frame: bool, as_json: bool) -> None:
    """Find the changes between two maps, write them to a folder and print a summary."""
    with open_output(out, _CHANGES_NAMES) as folder:
        maps = [read_source(path, warn) for path in (first, second)]
        points = [given.surfaces for given in maps]
        for path, found in zip((first, second), points, strict=True):
            if not len(found):
                raise InputError(path, "expected a map with walls, got one without")
        alignment = Alignment(np.zeros(3), 0.0, 1.0) if same_frame else align_points(points[1], points[0])
        if alignment.share < _LEAST_SHARE:
            problem = (
                f"expected another map of what {first} shows, but {alignment.share:.0%} of its walls agree with it"
            )
            raise InputError(second, problem)
        changes = find_changes(maps[0].grid, maps[1].grid, alignment)
        write_changes_png(folder.file("changes.png"), changes)
        document = {
            "schema": "gridslam.changes/1",
            "first": str(first),
            "second": str(second),
            "second_in_first": alignment.pose.tolist(),
            "walls_in_common": alignment.share,
            "residual_m": alignment.residual_m,
            "both_known_m2": changes.both_m2,
            "changes": describe_changes(changes),
        }
        folder.write_json("changes.json", document)
    print_result(document, _summarize_changes(changes, out), as_json)


def _summarize_changes(changes: Changes, out: Path) -> Iterator[str]:
    x, y, heading = changes.alignment.pose.tolist()
    yield (
        f"aligned: {x:.2f} m, {y:.2f} m, {np.rad2deg(heading):.2f} deg; {changes.alignment.share:.0%} of the walls "
        f"agree, to {changes.alignment.residual_m:.3f} m; {changes.both_m2:.0f} m\u00b2 are in both maps"
    )
    for kind in ("gone", "new"):
        own = [change.area_m2 for change in changes.changes if change.kind == kind]
        areas = ", ".join(f"{area:.2f}" for area in own[:8]) + ", ..." * (len(own) > 8)
        yield f"{kind}: " + (f"{counted(len(own), 'thing')} of {areas} m\u00b2" if own else "nothing")
    yield f"changes: {out / 'changes.png'}, {out / 'changes.json'}"
