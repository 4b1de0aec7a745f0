"""The image of a map_server map, and the occupancy that its pixels represent."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import InputError
from gridslam.io.maps.map_yaml import MapDescription

if TYPE_CHECKING:
    from PIL.Image import Image

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "MapImage", "occupancy_percent", "read_map_image", "unknown_read_as_free"]

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
"""What map savers write in trinary mode."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class MapImage:
    """A grey image.

    Attributes
    ----------
    brightness : (H, W) float64
        0 black to 255 white; whole numbers where a pixel has 8 bits. The first row is the top one.
    opaque : (H, W) bool
        Which pixels are not transparent in the least.
    """

    brightness: NDArray[np.float64]
    opaque: NDArray[np.bool_]


def read_map_image(path: str | Path) -> MapImage:
    """Read an image of any form that Pillow knows, PGM and PNG among them.

    Raises
    ------
    InputError
        There is no such file, it is no image, or one with colours.
    """
    from PIL import Image, UnidentifiedImageError  # only readers of maps pay for its import

    if not Path(path).is_file():
        raise InputError(path, "no such image file")
    try:
        with Image.open(path) as image:
            transparency = "A" in image.getbands() or "transparency" in image.info
            alpha = np.asarray(image.convert("RGBA"))[:, :, 3] if transparency else None
            brightness = _brightness(path, image)
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError, SyntaxError) as error:
        raise InputError(path, f"expected an image, got: {error}") from None
    return MapImage(brightness, np.ones(brightness.shape, np.bool_) if alpha is None else alpha == 255)


def _brightness(path: str | Path, image: Image) -> NDArray[np.float64]:
    """Brightness (H, W) from 0 to 255."""
    if image.mode == "I" or image.mode.startswith("I;16"):  # Pillow would cut 16 bits off at 255
        return np.asarray(image).astype(np.float64) / 257
    if image.mode in ("1", "L", "LA"):
        return np.asarray(image.convert("L")).astype(np.float64)
    red, green, blue = (np.asarray(band) for band in image.convert("RGB").split())
    coloured = (red != green) | (green != blue)
    if coloured.any():
        raise InputError(path, f"expected a grey image, got colours in {int(coloured.sum())} of {coloured.size} pixels")
    return red.astype(np.float64)


def occupancy_percent(
    image: MapImage, description: MapDescription, *, strict_thresholds: bool = False
) -> NDArray[np.int8]:
    """How occupied each cell is (H, W), 0 to 100, and -1 where that is unknown: the data of a ROS OccupancyGrid.

    The first row is the lowest one. The rules are those of map_server and nav2:

    - trinary: occupied (100) where a pixel is darker than occupied_thresh, free (0) where it is less dark than
      free_thresh, else unknown. The pixel 205 is unknown for any free_thresh, unless `strict_thresholds`.
    - scale: between the thresholds the percentage rises linearly, and nothing opaque is unknown.
    - raw: the pixel is the percentage, unknown above 100, for any negate and thresholds.

    A transparent pixel is unknown, but for raw.
    """
    if description.mode == "raw":
        percent = np.rint(image.brightness)
        return np.where(percent <= 100, percent, -1).astype(np.int8)[::-1]
    darkness, low, high = _darkness(image, description), description.free_thresh, description.occupied_thresh
    between = -1.0 if description.mode == "trinary" else np.rint(100 * (darkness - low) / (high - low))
    percent = np.where(darkness > high, 100, np.where(darkness < low, 0, between))
    if not strict_thresholds:
        percent[unknown_read_as_free(image, description)] = -1
    percent[~image.opaque] = -1
    return percent.astype(np.int8)[::-1]


def unknown_read_as_free(image: MapImage, description: MapDescription) -> NDArray[np.bool_]:
    """Which pixels (H, W) savers write for unknown, but the file's thresholds, read literally, make free."""
    if description.mode != "trinary" or description.negate:
        return np.zeros(image.opaque.shape, np.bool_)
    free = _darkness(image, description) < description.free_thresh
    return np.asarray(image.opaque & (image.brightness == UNKNOWN) & free)


def _darkness(image: MapImage, description: MapDescription) -> NDArray[np.float64]:
    """0 where a pixel is as a free one, 1 where it is as an occupied one."""
    return (image.brightness if description.negate else 255 - image.brightness) / 255
