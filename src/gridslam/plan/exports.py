"""A floor plan as a drawing in SVG and as GeoJSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np

from gridslam.io.geojson import format_features
from gridslam.plan.floor_plan import FloorPlan
from gridslam.types import FloatArray
from gridslam.viz.canvas import round_length

_STYLE = """\
text { font-family: Helvetica, Arial, sans-serif; text-anchor: middle; dominant-baseline: central }
polygon, polyline { fill: none; stroke-width: 0.25 }
.rooms { fill: #f7f4ec } .looked-into { fill: #e8f0f6 } .holes { fill: #fff }
.furniture { fill: #ece6d8; stroke: #6e7682 }
.unknown { stroke: #e17800; stroke-dasharray: 1.2 0.8 }
.walls { fill: #141820; stroke: #141820 } .faces { stroke: #141820; stroke-width: 0.5 }
.doors { fill: #0069be; stroke: #0069be } .text { fill: #141820; stroke: #141820 } text[class] { stroke: none }"""
_MARGIN_MM = 20.0
_LETTERS_MM = 2.6
_LONGEST_BAR_MM = 50.0
_NARROWEST_LABELLED_MM = 8.0


def write_svg(path: Path, plan: FloorPlan, name: str, scale: int) -> None:
    """Write a plan as a sheet at 1:`scale`, turned so that most walls run along its sides; one unit is 1 mm."""
    per_m = 1000 / scale
    c, s = np.cos(plan.dominant_rad), np.sin(plan.dominant_rad)
    turn = per_m * np.array([[c, s], [s, -c]])  # of rows; y is down
    shown = np.concatenate([wall.outline for wall in plan.walls] + [room.outline for room in plan.rooms]) @ turn
    low = shown.min(axis=0) - _MARGIN_MM
    width, height = np.ptp(shown, axis=0) + 2 * _MARGIN_MM
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.2f}mm" height="{height:.2f}mm" '
        f'viewBox="0 0 {width:.2f} {height:.2f}">',
        f"<title>{escape(name)}, 1:{scale}</title>\n<style>{_STYLE}</style>",
        f'<rect width="{width:.2f}" height="{height:.2f}" fill="#fff"/>',
    ]

    def draw(kind: str, points: FloatArray, tag: str = "polygon") -> None:
        corners = " ".join(f"{x:.2f},{y:.2f}" for x, y in points @ turn - low)
        lines.append(f'<{tag} class="{kind}" points="{corners}"/>')

    def write(kind: str, text: str, x: float, y: float, size_mm: float = _LETTERS_MM) -> None:
        lines.append(f'<text class="{kind}" x="{x:.2f}" y="{y:.2f}" font-size="{size_mm}">{escape(text)}</text>')

    for room in plan.rooms:
        draw("looked-into" if room.is_entered is False else "rooms", room.outline)
        for hole in room.holes:
            draw("holes", hole)
    for outline in plan.furniture:
        draw("furniture", outline)
    for room in plan.rooms:
        for side in room.unknown:
            draw("unknown", side, "polyline")
    for wall in plan.walls:
        draw("faces" if wall.thickness_m is None else "walls", wall.outline)
    for opening in plan.openings:
        draw("doors", opening.ends, "polyline")
        x, y = opening.ends.mean(axis=0) @ turn - low
        write("doors", f"{opening.width_m:.2f}", x, y - 2.0, 1.8)
    for room in plan.rooms:
        if np.ptp(room.outline @ turn, axis=0).min() >= _NARROWEST_LABELLED_MM:
            x, y = room.label_point @ turn - low
            write("text", room.name, x, y - 0.7 * _LETTERS_MM)
            write("text", f"{room.area_m2:.1f} m\u00b2", x, y + 0.7 * _LETTERS_MM)
    length_m = round_length(_LONGEST_BAR_MM / per_m)
    bar_mm = length_m * per_m
    lines.append(f'<path class="text" d="M{_MARGIN_MM} {height - 10:.2f}h{bar_mm:.2f}" stroke-width="0.6"/>')
    write("text", f"{length_m:g} m", _MARGIN_MM + bar_mm / 2, height - 7)
    write("text", f"{name}   1:{scale}", width / 2, 10.0, 4.0)
    path.write_text("\n".join([*lines, "</svg>", ""]), encoding="utf-8")


def describe_features(plan: FloorPlan) -> list[dict[str, Any]]:
    """Features of GeoJSON: walls, doors, rooms, furniture and unknown sides, each with its layer and its measures."""
    features = []
    for wall in plan.walls:
        measures = {"length_m": round(wall.length_m, 3)}
        if wall.thickness_m is None:
            features.append(_feature("walls", wall.ends, measures))
        else:
            features.append(_feature("walls", [wall.outline], measures | {"thickness_m": round(wall.thickness_m, 3)}))
    for opening in plan.openings:
        features.append(_feature("doors", opening.ends, {"kind": opening.kind, "width_m": round(opening.width_m, 3)}))
    for room in plan.rooms:
        about = {"name": room.name, "area_m2": round(room.area_m2, 3), "entered": room.is_entered}
        features.append(_feature("rooms", [room.outline, *room.holes], about))
        features += [_feature("unknown", side, {"room": room.name}) for side in room.unknown]
    return features + [_feature("furniture", [outline], {}) for outline in plan.furniture]


def _feature(layer: str, points: FloatArray | list[FloatArray], measures: dict[str, Any]) -> dict[str, Any]:
    """A line through points (K, 2), or a polygon of rings, to the millimetre."""
    if isinstance(points, list):
        rings = [(np.round(np.concatenate([ring, ring[:1]]), 3) + 0.0).tolist() for ring in points]
        geometry = {"type": "Polygon", "coordinates": rings}
    else:
        geometry = {"type": "LineString", "coordinates": (np.round(points, 3) + 0.0).tolist()}
    return {"type": "Feature", "properties": {"layer": layer, **measures}, "geometry": geometry}


def write_geojson(path: Path, plan: FloorPlan, name: str) -> None:
    """Write a plan as GeoJSON (RFC 7946) in metres of the map's frame.

    The RFC wants degrees; metres are the prior arrangement that its section 4 allows, stated in "units".
    """
    document = {"type": "FeatureCollection", "name": name, "units": "m"}
    path.write_text(format_features(document, describe_features(plan)), encoding="utf-8")
