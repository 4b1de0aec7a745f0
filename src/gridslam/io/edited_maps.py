"""Maps with their edits: walls drawn and areas erased."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.io.edits import Edit, Edits
from gridslam.io.maps import read_map_description
from gridslam.io.text import compute_digest
from gridslam.types import OccupancyGrid

_BoolArray: TypeAlias = NDArray[np.bool_]
_SURE_LOG_ODDS = 4.6  # of probability 0.99, as maps are read


def check_edits(
    edits: Edits, path: str | Path, map_yaml: Path, grid: OccupancyGrid, on_remark: Callable[[str], None]
) -> None:
    """Check that edits, of the file `path`, lie in a map; remark where its image is not that which they were drawn on.

    Raises
    ------
    InputError
        With the number of the feature, where an edit lies outside the map.
    """
    if edits.map_sha256 not in ("", compute_image_digest(map_yaml)):
        on_remark(f"{path}: drawn on another image of {map_yaml}: look whether the edits lie where they should")
    low = np.array(grid.origin)
    high = low + np.array(grid.shape[::-1]) * grid.resolution_m
    for number, edit in enumerate(edits.edits, start=1):
        if (edit.points.max(axis=0) < low).any() or (edit.points.min(axis=0) > high).any():
            x, y = edit.points[0].tolist()
            problem = f"expected places in the map, {low[0]:g} to {high[0]:g} and {low[1]:g} to {high[1]:g} m"
            raise InputError(path, f"feature {number}: {problem}, got {x:g}, {y:g}")


def compute_image_digest(map_yaml: str | Path) -> str:
    """Compute the SHA-256 of a map's image."""
    return compute_digest(Path(map_yaml).parent / read_map_description(map_yaml).image)


def apply_edits(grid: OccupancyGrid, edits: Edits) -> OccupancyGrid:
    """Make erased areas free, and then the walls that were drawn occupied; parts outside the map are left out."""
    log_odds, known = grid.log_odds.copy(), grid.known.copy()
    for layer, value in (("erased", -_SURE_LOG_ODDS), ("walls", _SURE_LOG_ODDS)):
        for edit in edits.of(layer):
            window, inside = cells_of(edit, grid)
            log_odds[window][inside] = value
            known[window][inside] = True
    return OccupancyGrid(log_odds, known, grid.resolution_m, grid.origin)


def cells_of(edit: Edit, grid: OccupancyGrid) -> tuple[tuple[slice, slice], _BoolArray]:
    """Cells of a map that an edit covers: those in or on a polygon, or on a line, which is at least three cells wide.

    Returns
    -------
    window : (slice, slice)
        Rows and columns about the edit.
    inside : (h, w) bool
        Of the window.
    """
    from PIL import Image, ImageDraw  # only edits pay for its import

    places = (edit.points - np.array(grid.origin)) / grid.resolution_m - 0.5  # in cells, from the middle of the first
    width = max(3, round(edit.width_m / grid.resolution_m)) if edit.geometry == "LineString" else 0
    low = np.clip(np.floor(places.min(axis=0)) - width, 0, grid.shape[::-1]).astype(np.int64)
    high = np.clip(np.ceil(places.max(axis=0)) + width + 1, low, grid.shape[::-1]).astype(np.int64)
    image = Image.new("1", (max(1, int(high[0] - low[0])), max(1, int(high[1] - low[1]))))
    corners = [tuple(corner) for corner in (places - low).tolist()]
    if edit.geometry == "Polygon":
        ImageDraw.Draw(image).polygon(corners, fill=1, outline=1)
    else:
        ImageDraw.Draw(image).line(corners, fill=1, width=width, joint="curve")
    window = slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))
    return window, np.array(image, np.bool_)[: high[1] - low[1], : high[0] - low[0]]
