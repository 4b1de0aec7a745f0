"""Maps as ROS's map_server reads them: an image and a small YAML file beside it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.io.maps.image import FREE, OCCUPIED, UNKNOWN, occupancy_percent, read_map_image, unknown_read_as_free
from gridslam.io.maps.map_yaml import FREE_THRESH, OCCUPIED_THRESH, MapDescription, read_map_description
from gridslam.types import GridRows, OccupancyGrid

__all__ = ["read_map", "write_map"]

_BAND = 64  # rows turned to pixels at a time
_SURE = 0.98  # an image represents probabilities 0.01 to 0.99, so that log-odds stay finite


def write_map(yaml_path: str | Path, grid: GridRows) -> None:
    """Write a map in trinary form: occupied above probability 0.65, free below 0.196, unknown otherwise.

    The image has its first row at the top, where y is largest. free_thresh lies below the 0.19608 that the pixel 205
    means, so that unknown stays unknown for every reader.

    Parameters
    ----------
    yaml_path : str or Path
        The file to write; its image is a binary PGM of the same name beside it.
    grid : OccupancyGrid, or another that gives rows
        The map, at least one cell.
    """
    height, width = grid.shape
    if height == 0 or width == 0:
        raise ArgumentError("grid", "at least one cell", grid.shape)
    image_path = Path(yaml_path).with_suffix(".pgm")
    with image_path.open("wb") as file:
        file.write(f"P5\n{width} {height}\n255\n".encode())
        for top in range(height, 0, -_BAND):
            file.write(_pixels(grid.rows(max(top - _BAND, 0), top))[::-1].tobytes())
    x, y = (float(value) for value in grid.origin)
    description = MapDescription(image_path.name, float(grid.resolution_m), (x, y))
    Path(yaml_path).write_text(description.to_yaml(), encoding="utf-8")


def _pixels(grid: OccupancyGrid) -> NDArray[np.uint8]:
    pixels = np.full(grid.shape, UNKNOWN, dtype=np.uint8)
    pixels[grid.known & (grid.log_odds > _log_odds(OCCUPIED_THRESH))] = OCCUPIED
    pixels[grid.known & (grid.log_odds < _log_odds(FREE_THRESH))] = FREE
    return pixels


def read_map(
    yaml_path: str | Path, *, strict_thresholds: bool = False, tell: Callable[[str], None] = lambda remark: None
) -> OccupancyGrid:
    """Read a map as map_server and nav2 do, modes trinary, scale and raw (`occupancy_percent` has the rules).

    Occupied cells get probability 0.99, free ones 0.01, and percentages between get probabilities between.

    Parameters
    ----------
    yaml_path : str or Path
        The YAML file; its image is named relative to it.
    strict_thresholds : bool
        Apply the thresholds literally. Otherwise the pixel 205 of a trinary map that is not negated is unknown for any
        free_thresh: every map saver writes it for unknown, and a free_thresh of 0.25, as nav2's saver writes it, would
        turn all unobserved cells into free space. If it would, a remark is issued.
    tell : callable
        Gets what is odd about the file, and what was made of it: a remark of one sentence each.

    Raises
    ------
    InputError
        The YAML file or the image cannot be read, a value is missing or out of range, the map is rotated, or the image
        is not grey.
    """
    description = read_map_description(yaml_path)
    image = read_map_image(Path(yaml_path).parent / description.image)
    percent = occupancy_percent(image, description, strict_thresholds=strict_thresholds)
    known = percent >= 0
    probability = (1 - _SURE) / 2 + _SURE * percent / 100.0
    odds = np.divide(probability, 1 - probability, out=np.ones(percent.shape), where=known)
    grid = OccupancyGrid(np.log(odds).astype(np.float32), known, description.resolution_m, description.origin)
    spared = 0 if strict_thresholds else int(unknown_read_as_free(image, description).sum())
    if spared:
        tell(
            f"free_thresh {description.free_thresh:g} makes the pixel 205 free, by which map savers mean unknown: "
            f"its {spared} cells are taken as unknown"
        )
    return grid


def _log_odds(probability: float) -> float:
    return math.log(probability / (1 - probability))
