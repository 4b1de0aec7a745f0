"""A floor plan as DXF for CAD, and as GeoJSON for programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gridslam.errors import MissingDependencyError
from gridslam.io.geojson import format_features
from gridslam.plan.floor_plan import FloorPlan
from gridslam.types import FloatArray

_LAYERS = {"WALLS": 7, "DOORS": 5, "ROOMS": 3, "UNKNOWN": 30, "FURNITURE": 8}
"""Layers of the DXF, and their colours by the index of AutoCAD."""


def describe_features(plan: FloorPlan) -> list[dict[str, Any]]:
    """Features of GeoJSON: walls, doors, rooms, furniture and unknown sides, each with its layer and its measures."""

    def ring(points: FloatArray) -> list[list[float]]:
        return _positions(np.concatenate([points, points[:1]]))

    def line(points: FloatArray) -> dict[str, Any]:
        return {"type": "LineString", "coordinates": _positions(points)}

    features = []
    for wall in plan.walls:
        measures = {"length_m": round(wall.length_m, 3)}
        if wall.thickness_m is None:
            features.append(_feature("walls", line(wall.ends), measures))
        else:
            measures["thickness_m"] = round(wall.thickness_m, 3)
            features.append(_feature("walls", _polygon([ring(wall.outline)]), measures))
    for opening in plan.openings:
        measures = {"width_m": round(opening.width_m, 3)}
        features.append(_feature("doors", line(opening.ends), {"kind": opening.kind, **measures}))
    for room in plan.rooms:
        rings = [ring(room.outline), *(ring(hole) for hole in room.holes)]
        about = {"name": room.name, "area_m2": round(room.area_m2, 3), "entered": room.is_entered}
        features.append(_feature("rooms", _polygon(rings), about))
        features += [_feature("unknown", line(side), {"room": room.name}) for side in room.unknown]
    features += [_feature("furniture", _polygon([ring(outline)]), {}) for outline in plan.furniture]
    return features


def _feature(layer: str, geometry: dict[str, Any], measures: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "properties": {"layer": layer, **measures}, "geometry": geometry}


def _polygon(rings: list[list[list[float]]]) -> dict[str, Any]:
    return {"type": "Polygon", "coordinates": rings}


def _positions(points: FloatArray) -> list[list[float]]:
    """Positions of points, to the millimetre."""
    return [[float(x) + 0.0, float(y) + 0.0] for x, y in np.round(points, 3)]


def write_geojson(path: Path, plan: FloorPlan, name: str) -> None:
    """Write a plan as GeoJSON (RFC 7946) in metres of the map's frame.

    The RFC wants degrees; metres are the prior arrangement that its section 4 allows, stated in "units".
    """
    document = {"type": "FeatureCollection", "name": name, "units": "m", "turned_rad": plan.turned_rad}
    path.write_text(format_features(document, describe_features(plan)), encoding="utf-8")


def write_dxf(path: Path, plan: FloorPlan) -> None:
    """Write a plan as DXF R2010 in metres: layers WALLS, DOORS, ROOMS, UNKNOWN and FURNITURE.

    Raises
    ------
    MissingDependencyError
        ezdxf is not installed; the extra ``map`` brings it.
    """
    try:
        from ezdxf import units
        from ezdxf.document import Drawing
        from ezdxf.enums import TextEntityAlignment
    except ImportError:
        raise MissingDependencyError("DXF", "ezdxf", "map") from None
    drawing = Drawing.new("R2010")
    drawing.units = units.M
    for layer, colour in _LAYERS.items():
        drawing.layers.add(layer, color=colour)
    space = drawing.modelspace()

    def outline(points: FloatArray, layer: str, closed: bool = True) -> None:
        space.add_lwpolyline(points.tolist(), close=closed, dxfattribs={"layer": layer})

    def write(text: str, where: FloatArray, layer: str, height: float) -> None:
        entity = space.add_text(text, height=height, dxfattribs={"layer": layer})
        entity.set_placement(tuple(where.tolist()), align=TextEntityAlignment.MIDDLE_CENTER)

    for wall in plan.walls:
        outline(wall.outline if wall.thickness_m else wall.ends, "WALLS", wall.thickness_m is not None)
    for opening in plan.openings:
        outline(opening.ends, "DOORS", False)
        write(f"{opening.width_m:.2f}", opening.ends.mean(axis=0), "DOORS", 0.15)
    for room in plan.rooms:
        for ring in (room.outline, *room.holes):
            outline(ring, "ROOMS")
        write(f"{room.name} {room.area_m2:.1f} m2", room.label_point, "ROOMS", 0.25)
        for side in room.unknown:
            outline(side, "UNKNOWN", False)
    for piece in plan.furniture:
        outline(piece, "FURNITURE")
    drawing.saveas(path)
