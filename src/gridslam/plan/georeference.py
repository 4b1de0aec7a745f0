"""The place of a map on the earth: fitted to points in degrees, and written with its picture as GeoTIFF."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from gridslam.geometry import se2
from gridslam.io.maps import map_pixels
from gridslam.plan.alignment import fit_pairs
from gridslam.plan.world import WorldOrigin
from gridslam.types import FloatArray, OccupancyGrid

_TRANSFORMATION, _KEYS = 34264, 34735  # tags of GeoTIFF 1.1 (OGC 19-008r4): ModelTransformation, GeoKeyDirectory
_SHORT, _DOUBLE = 3, 12  # types of TIFF
_DIRECTORY = (
    (1, 1, 1, 4),  # version 1.1, four keys
    (1024, 0, 1, 2),  # GTModelType: geographic
    (1025, 0, 1, 1),  # GTRasterType: a pixel is an area
    (2048, 0, 1, 4326),  # GeodeticCRS: WGS84
    (2054, 0, 1, 9102),  # GeogAngularUnits: degrees
)


def fit_world(places: FloatArray, degrees: FloatArray) -> tuple[WorldOrigin, FloatArray]:
    """Fit the georeference of a map on WGS84, without a scale; and the residuals (P,), m.

    Parameters
    ----------
    places : (P, 2) float64, m
        At least two, in the map's frame.
    degrees : (P, 2) float64
        Latitude and longitude of each.
    """
    local = WorldOrigin(*degrees.mean(axis=0).tolist())
    metres = local.to_metres(degrees[:, ::-1])
    heading = fit_pairs(places, metres)[0].pose[2]
    shift = (metres - se2.transform_points([0.0, 0.0, heading], places)).mean(axis=0)
    left = np.hypot(*(metres - se2.transform_points([*shift, heading], places)).T)
    ((longitude, latitude),) = local.to_degrees(shift[None]).tolist()
    return WorldOrigin(latitude, longitude, (90.0 - float(np.rad2deg(heading))) % 360.0), left


def write_geotiff(path: Path, grid: OccupancyGrid, origin: WorldOrigin) -> None:
    """Write a map as GeoTIFF in degrees of WGS84: its pixels as in map.pgm, turned as it lies."""
    height, _ = grid.shape
    corner, side = np.array(grid.origin), grid.resolution_m
    pixels = np.array([[0.0, height], [1.0, height], [0.0, height - 1.0]])  # of the corner, one to the right, one down
    at, right, down = origin.to_degrees(corner + side * pixels)
    a, b = right - at, down - at
    matrix = (a[0], b[0], 0.0, at[0], a[1], b[1], 0.0, at[1], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    tags = ImageFileDirectory_v2()
    tags.tagtype[_TRANSFORMATION], tags.tagtype[_KEYS] = _DOUBLE, _SHORT
    tags[_TRANSFORMATION] = tuple(float(value) for value in matrix)
    tags[_KEYS] = tuple(value for row in _DIRECTORY for value in row)
    Image.fromarray(map_pixels(grid)[::-1]).save(path, format="TIFF", tiffinfo=tags, compression="tiff_adobe_deflate")
