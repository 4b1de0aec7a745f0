"""Georeference of a map, and its edits in degrees of WGS84, as GIS programs read and write them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, final

import numpy as np

from gridslam.geometry import se2
from gridslam.io.edits import Edits
from gridslam.io.geojson import format_features
from gridslam.types import FloatArray

_SEMIMAJOR_M = 6_378_137.0
_ECCENTRICITY2 = 6.69437999014e-3


@final
class WorldOrigin(NamedTuple):
    """Position of a map's origin on WGS84, degrees, and the bearing of its x axis, degrees clockwise from north."""

    latitude: float
    longitude: float
    bearing: float = 90.0

    def to_degrees(self, points: FloatArray) -> FloatArray:
        """Longitude and latitude (N, 2) of points (N, 2), m: exact to millimetres within a kilometre.

        Source: the radii of curvature of the ellipsoid, Torge and Mueller, Geodesy, section 4.1.
        """
        turned = se2.transform_points([0.0, 0.0, math.radians(90.0 - self.bearing)], points)
        return np.asarray(np.array([self.longitude, self.latitude]) + np.rad2deg(turned / self._radii()))

    def to_metres(self, degrees: FloatArray) -> FloatArray:
        """Points (N, 2), m, of longitude and latitude (N, 2): the inverse of `to_degrees`."""
        turned = np.deg2rad(degrees - [self.longitude, self.latitude]) * self._radii()
        return se2.transform_points([0.0, 0.0, math.radians(self.bearing - 90.0)], turned)

    def _radii(self) -> FloatArray:
        """Radii (2,), m, of the circle of latitude and of the meridian."""
        root = math.sqrt(1 - _ECCENTRICITY2 * math.sin(math.radians(self.latitude)) ** 2)
        parallel = _SEMIMAJOR_M / root * math.cos(math.radians(self.latitude))
        return np.array([parallel, _SEMIMAJOR_M * (1 - _ECCENTRICITY2) / root**3])


def format_edits_in_degrees(edits: Edits, origin: WorldOrigin) -> str:
    """Return the text of a GeoJSON file (RFC 7946) of edits, without the scans that they follow."""

    def convert(feature: dict[str, Any]) -> dict[str, Any]:
        kept = {key: value for key, value in feature["properties"].items() if key not in ("anchor", "drive")}
        return dict(_convert(feature | {"properties": kept}, lambda place: np.round(origin.to_degrees(place), 9)))

    head = {"type": "FeatureCollection", "units": "degrees", "origin": list(origin)}
    return format_features(head, (convert(edit.to_feature()) for edit in edits.edits))


def turn_edits_to_metres(document: Mapping[str, Any], origin: WorldOrigin) -> dict[str, Any]:
    """Return a document of edits in degrees as one in metres, unchecked (see `parse_edits`); one in metres as it is."""
    features = document.get("features")
    if document.get("units", "degrees") != "degrees" or not isinstance(features, list):
        return dict(document)
    return {**document, "units": "m", "features": [_convert(feature, origin.to_metres) for feature in features]}


def _convert(feature: Any, function: Callable[[FloatArray], FloatArray]) -> Any:  # noqa: ANN401
    """Convert the positions of a feature; other values stay as they are."""

    def convert(value: Any) -> Any:  # noqa: ANN401
        if not isinstance(value, list):
            return value
        is_position = len(value) in (2, 3) and all(type(number) in (int, float) for number in value)
        if is_position and max(abs(number) for number in value[:2]) <= 360:  # the third one is a height
            return function(np.array([value[:2]], np.float64))[0].tolist()
        return [convert(item) for item in value]

    geometry = feature.get("geometry") if isinstance(feature, dict) else None
    if not isinstance(geometry, dict):
        return feature
    return {**feature, "geometry": {**geometry, "coordinates": convert(geometry.get("coordinates"))}}
