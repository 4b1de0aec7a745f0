"""Small copies of maps and pictures, for pages that show many of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from gridslam.errors import InputError
from gridslam.io.images import open_image

__all__ = ["write_thumbnail"]

_UNKNOWN = 205  # of map_server
_MARGIN_PX = 4
_WALL = 100  # a cell at most this bright is a wall
_BYTES_PER_PIXEL = 10  # copies, and averages of walls


def write_thumbnail(picture: Path, thumbnail: Path, side_px: int = 192) -> bool:
    """Write a JPEG copy of a picture or of a map (PGM), whose longer side is `side_px`.

    Of a map the known part is shown, and walls keep their darkness however thin they become.

    Returns
    -------
    bool
        False where the picture cannot be read; then nothing is written.

    Raises
    ------
    OSError
        The copy cannot be written.
    """
    try:
        with open_image(picture, _BYTES_PER_PIXEL) as whole:
            small = _shrink_map(whole, side_px) if whole.mode == "L" else _shrink(whole.convert("RGB"), side_px)
    except InputError:
        return False
    small.save(thumbnail, "JPEG", quality=82)
    return True


def _shrink(picture: Image.Image, side_px: int) -> Image.Image:
    picture.thumbnail((side_px, side_px), Image.Resampling.BOX)
    return picture


def _shrink_map(picture: Image.Image, side_px: int) -> Image.Image:
    """Average blocks of cells; a block with a wall in it becomes dark."""
    levels = np.asarray(picture)
    rows = np.flatnonzero((levels != _UNKNOWN).any(axis=1))
    columns = np.flatnonzero((levels != _UNKNOWN).any(axis=0))
    if len(rows):
        top, left = max(rows[0] - _MARGIN_PX, 0), max(columns[0] - _MARGIN_PX, 0)
        levels = levels[top : rows[-1] + _MARGIN_PX, left : columns[-1] + _MARGIN_PX]
    block = -(-max(levels.shape) // side_px)
    whole = [-(-side // block) * block for side in levels.shape]
    padded = np.full(whole, _UNKNOWN, np.uint8)
    padded[: levels.shape[0], : levels.shape[1]] = levels
    blocks = padded.reshape(whole[0] // block, block, whole[1] // block, block)
    darkest = blocks.min(axis=(1, 3))
    mean = blocks.mean(axis=(1, 3), dtype=np.float32)
    return Image.fromarray(np.where(darkest <= _WALL, np.minimum(mean, 70.0), mean).astype(np.uint8))
