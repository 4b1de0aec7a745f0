"""Edits of a map: layers of walls, erased areas, rooms and zones for robots, in one GeoJSON file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, final

import numpy as np

from gridslam.errors import InputError
from gridslam.io.geojson import format_features
from gridslam.io.output import write_atomically
from gridslam.io.text import read_json
from gridslam.types import FloatArray

SCHEMA = "gridslam.edits/1"
LAYERS: Mapping[str, tuple[str, ...]] = {
    "walls": ("LineString", "Polygon"),
    "erased": ("Polygon",),
    "rooms": ("Point", "Polygon"),
    "keep_out": ("Polygon",),
    "no_go": ("LineString",),
    "speed": ("Polygon",),
}
"""Each layer, and the geometries that it may have."""
_WIDTH_M = 0.1
_MOST_FEATURES = 10_000
_MOST_CORNERS = 1000
_LONGEST_NAME = 100
_FARTHEST_M = 1e6
_LEAST_AREA_M2 = 1e-6


@final
@dataclass(frozen=True, slots=True, eq=False)
class Edit:
    """Something that a person has drawn on a map.

    Attributes
    ----------
    layer : str
        One of `LAYERS`.
    geometry : str
        "Point", "LineString" or "Polygon".
    points : (K, 2) float64, m
        In the map's frame; of a polygon the corners, anticlockwise, the first not repeated.
    name : str
        Of a room.
    width_m : float, m
        Of a line.
    limit_percent : float, 1 to 100
        Of a speed zone, of the highest speed; 0 of another edit.
    """

    layer: str
    geometry: str
    points: FloatArray
    name: str = ""
    width_m: float = 0.0
    limit_percent: float = 0.0

    def to_feature(self) -> dict[str, Any]:
        """Return the feature of GeoJSON, with positions to 0.1 mm."""
        places = (np.round(self.points, 4) + 0.0).tolist()
        coordinates = {"Point": places[0], "LineString": places, "Polygon": [[*places, places[0]]]}[self.geometry]
        given = {"name": self.name, "width_m": self.width_m, "limit_percent": self.limit_percent}
        properties = {"layer": self.layer, **{key: value for key, value in given.items() if value}}
        geometry = {"type": self.geometry, "coordinates": coordinates}
        return {"type": "Feature", "properties": properties, "geometry": geometry}


@final
@dataclass(frozen=True, slots=True, eq=False)
class Edits:
    """Edits of a map.

    Attributes
    ----------
    edits : tuple of Edit
        In the order in which they were drawn.
    map_name : str
        File of the map that they belong to, relative to their own; empty where none is named.
    map_sha256 : str
        Digest of the map's image when they were drawn; empty where it is not known.
    """

    edits: tuple[Edit, ...] = ()
    map_name: str = ""
    map_sha256: str = ""

    def of(self, *layers: str) -> list[Edit]:
        """Those of some layers."""
        return [edit for edit in self.edits if edit.layer in layers]

    def to_text(self) -> str:
        """Return the file's text: a line for each feature."""
        head: dict[str, Any] = {"type": "FeatureCollection", "schema": SCHEMA, "units": "m", "frame": "map"}
        if self.map_name:
            head["map"] = {"file": self.map_name, "sha256": self.map_sha256}
        return format_features(head, (edit.to_feature() for edit in self.edits))


def write_edits(path: str | Path, edits: Edits) -> None:
    """Write edits atomically: a process that is killed leaves the file as it was before, or the new one."""
    with write_atomically(path) as aside:
        aside.write_text(edits.to_text(), encoding="utf-8")


def read_edits(path: str | Path) -> Edits:
    """Read edits, and check each feature.

    Raises
    ------
    InputError
        With the number of the feature, from 1: it has no layer of `LAYERS`, or another geometry; a polygon has
        no area; a number is missing or out of range; positions are not in m of the map's frame.
    """
    return parse_edits(read_json(path), path)


def parse_edits(document: Mapping[str, Any], path: str | Path) -> Edits:
    """Check edits that were parsed, as `read_edits`; `path` names the file in errors."""
    features = document.get("features")
    if document.get("type") != "FeatureCollection" or not isinstance(features, list):
        raise InputError(path, "expected a FeatureCollection of GeoJSON with features")
    for key, expected in (("schema", SCHEMA), ("units", "m"), ("frame", "map")):
        if document.get(key, expected) != expected:
            raise InputError(path, f"expected the {key} {expected!r}, got {document[key]!r}"[:200])
    if len(features) > _MOST_FEATURES:
        raise InputError(path, f"expected at most {_MOST_FEATURES} features, got {len(features)}")
    named = document.get("map", {"file": "", "sha256": ""})
    if not (isinstance(named, dict) and all(isinstance(named.get(key), str) for key in ("file", "sha256"))):
        raise InputError(path, "expected map: the file of a map and its sha256")
    edits = []
    for number, feature in enumerate(features, start=1):
        try:
            edits.append(_parse_feature(feature))
        except ValueError as error:
            raise InputError(path, f"feature {number}: {error}") from None
    return Edits(tuple(edits), named["file"], named["sha256"])


def _parse_feature(feature: Any) -> Edit:  # noqa: ANN401
    """Read a feature; raises ValueError with its fault."""
    if not (isinstance(feature, dict) and all(isinstance(feature.get(k), dict) for k in ("properties", "geometry"))):
        raise ValueError("expected properties and a geometry")
    properties, geometry = feature["properties"], feature["geometry"]
    layer, kind = properties.get("layer"), geometry.get("type")
    if not isinstance(layer, str) or layer not in LAYERS:
        raise ValueError(f"expected a layer of {', '.join(LAYERS)}, got {str(layer)[:40]!r}")
    if kind not in LAYERS[layer]:
        raise ValueError(f"expected a {' or '.join(LAYERS[layer])} in the layer {layer}, got {str(kind)[:40]!r}")
    is_line = kind == "LineString"
    return Edit(
        layer,
        kind,
        _read_points(kind, geometry.get("coordinates")),
        _read_name(properties) if layer == "rooms" else "",
        _read_number(properties, "width_m", 0.01, 10.0, _WIDTH_M) if is_line else 0.0,
        _read_number(properties, "limit_percent", 1.0, 100.0, math.nan) if layer == "speed" else 0.0,
    )


def _read_name(properties: Mapping[str, Any]) -> str:
    name = properties.get("name", "")
    if not (isinstance(name, str) and 0 < len(name) <= _LONGEST_NAME and name.isprintable()):
        raise ValueError(f"expected a name of 1 to {_LONGEST_NAME} printable letters, got {str(name)[:40]!r}")
    return name


def _read_number(properties: Mapping[str, Any], key: str, low: float, high: float, otherwise: float) -> float:
    number = properties.get(key, otherwise)
    if not (type(number) in (int, float) and low <= number <= high):
        raise ValueError(f"expected {key} from {low:g} to {high:g}, got {str(number)[:40]}")
    return float(number)


def _are_finite(values: list[Any]) -> bool:
    return all(type(value) in (int, float) and abs(value) < 1e12 for value in values)


def _read_points(kind: str, coordinates: Any) -> FloatArray:  # noqa: ANN401
    """Points of a geometry, checked; the ring of a polygon without its repeated corner, anticlockwise."""
    if kind == "Polygon":
        if not (isinstance(coordinates, list) and len(coordinates) == 1):
            raise ValueError("expected a polygon of one ring, without holes")
        coordinates = coordinates[0]
    places = [coordinates] if kind == "Point" else coordinates
    if not isinstance(places, list) or not all(
        isinstance(p, list) and len(p) in (2, 3) and _are_finite(p) for p in places
    ):
        raise ValueError(f"expected positions [x, y] of the {kind}, in m")
    least = {"Point": 1, "LineString": 2, "Polygon": 4}[kind]
    if not least <= len(places) <= _MOST_CORNERS:
        raise ValueError(f"expected {least} to {_MOST_CORNERS} positions of the {kind}, got {len(places)}")
    points = np.array([place[:2] for place in places], np.float64)
    if np.abs(points).max() > _FARTHEST_M:
        raise ValueError(f"expected positions within {_FARTHEST_M:g} m of the origin, got {np.abs(points).max():g}")
    if kind == "LineString" and not np.ptp(points, axis=0).any():
        raise ValueError("expected a line with a length, got a single place")
    return _check_ring(points) if kind == "Polygon" else points


def _check_ring(points: FloatArray) -> FloatArray:
    """Corners of a closed ring (K + 1, 2), anticlockwise; raises ValueError where it has no area."""
    if (points[0] != points[-1]).any():
        raise ValueError("expected a closed ring, whose last position is the first one")
    ring = points[:-1]
    x, y = (ring - points[0]).T
    area = 0.5 * float((x * np.roll(y, -1) - np.roll(x, -1) * y).sum())
    if abs(area) < _LEAST_AREA_M2:
        raise ValueError("expected a polygon with an area")
    return np.asarray(ring if area > 0 else ring[::-1])
