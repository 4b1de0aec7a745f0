"""Maps as ROS's map_server reads them: an image and a small YAML file beside it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError, InputError
from gridslam.io.map_yaml import FREE_THRESH, OCCUPIED_THRESH, MapDescription, read_map_description
from gridslam.types import OccupancyGrid

__all__ = ["read_map", "write_map"]

_OCCUPIED, _FREE, _UNKNOWN = 0, 254, 205
_SURE = 0.98  # what an image says spans probabilities 0.01 to 0.99, so that log-odds stay finite


def write_map(yaml_path: str | Path, grid: OccupancyGrid) -> None:
    """Write a map in trinary form: occupied above probability 0.65, free below 0.196, unknown otherwise.

    The image has its first row at the top, where y is largest. free_thresh lies below the 0.19608 that the pixel 205
    means, so that unknown stays unknown for every reader.

    Parameters
    ----------
    yaml_path : str or Path
        The file to write; its image is a binary PGM of the same name beside it.
    grid : OccupancyGrid
        The map, at least one cell.
    image : str, optional
        How the YAML file names the image; the image's name without folder if not given.
    """
    height, width = grid.log_odds.shape
    if height == 0 or width == 0:
        raise ArgumentError("grid", "at least one cell", grid.log_odds.shape)
    pixels = np.full((height, width), _UNKNOWN, dtype=np.uint8)
    pixels[grid.known & (grid.log_odds > _log_odds(OCCUPIED_THRESH))] = _OCCUPIED
    pixels[grid.known & (grid.log_odds < _log_odds(FREE_THRESH))] = _FREE
    image_path = Path(yaml_path).with_suffix(".pgm")
    with image_path.open("wb") as file:
        file.write(f"P5\n{width} {height}\n255\n".encode())
        file.write(pixels[::-1].tobytes())
    x, y = (float(value) for value in grid.origin)
    description = MapDescription(image_path.name, float(grid.resolution_m), (x, y))
    Path(yaml_path).write_text(description.to_yaml(), encoding="utf-8")


def read_map(yaml_path: str | Path) -> OccupancyGrid:
    """Read a map as map_server would, modes trinary, scale and raw.

    Occupied cells get probability 0.99, free ones 0.01; in the modes scale and raw the values between lie between. In
    trinary mode the pixel 205 of a map that is not negated is unknown whatever free_thresh says: it is what every map
    saver writes for unknown, and a free_thresh of 0.25, as is common, would turn it into free space. Transparent pixels
    are unknown.

    Raises
    ------
    InputError
        Where the YAML file or the image cannot be read, a value is missing or out of range, or the map is rotated.
    """
    description = read_map_description(yaml_path)
    pixels, transparent = _read_image(Path(yaml_path).parent / description.image)
    occupied, known = _interpret(pixels, description)
    occupied, known = occupied[::-1], known[::-1] & ~transparent[::-1]
    probability = (1 - _SURE) / 2 + _SURE * occupied
    log_odds = np.where(known, np.log(probability / (1 - probability)), 0.0).astype(np.float32)
    return OccupancyGrid(log_odds, known, description.resolution_m, description.origin)


def _interpret(pixels: NDArray[np.uint8], description: MapDescription) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """How occupied (0 to 1) each pixel is, and whether it is known."""
    if description.mode == "raw":
        return np.minimum(pixels, 100) / 100.0, pixels <= 100
    darkness = (pixels if description.negate else 255.0 - pixels) / 255.0
    low, high = description.free_thresh, description.occupied_thresh
    if description.mode == "scale":
        return np.clip((darkness - low) / (high - low), 0.0, 1.0), np.ones(pixels.shape, dtype=np.bool_)
    occupied, known = darkness > high, (darkness > high) | (darkness < low)
    if not description.negate:
        known &= pixels != _UNKNOWN
    return occupied.astype(np.float64), known


def _read_image(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Brightness (H, W) of an image, and which of its pixels are transparent."""
    from PIL import Image, UnidentifiedImageError  # only readers of maps pay for its import

    if not path.is_file():
        raise InputError(path, "no such image file")
    try:
        with Image.open(path) as image:
            transparency = "A" in image.getbands() or "transparency" in image.info
            alpha = np.asarray(image.convert("RGBA"))[:, :, 3] if transparency else None
            pixels = np.asarray(image.convert("L"))
    except (UnidentifiedImageError, OSError, ValueError, SyntaxError) as error:
        raise InputError(path, f"expected an image, got: {error}") from None
    return pixels, np.zeros(pixels.shape, dtype=np.bool_) if alpha is None else alpha < 255


def _log_odds(probability: float) -> float:
    return math.log(probability / (1 - probability))
