"""Antialiased strokes: a part of the page is enlarged, painted on with hard edges, and reduced again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw

from gridslam.types import FloatArray
from gridslam.viz.palette import Colour

__all__ = ["disc", "stroke"]

_FINE = 3  # subpixels a side: 10 levels of coverage
_TILE_PX = 192  # a tile of the page, 1.3 MB when enlarged


def stroke(page: Image.Image, segments: FloatArray, colours: list[Colour], width_px: float) -> None:
    """Paint segments with a round end each, so that the segments of a path join smoothly.

    Parameters
    ----------
    page : Image, RGB
        Painted on; what lies outside of it is cut off.
    segments : (K, 4) float64, px
        [x0, y0, x1, y1] on the page, x to the right and y down.
    colours : list of K (r, g, b)
        Later segments cover earlier ones.
    width_px : float, px, > 0
    """
    low = np.minimum(segments[:, :2], segments[:, 2:]) - width_px
    high = np.maximum(segments[:, :2], segments[:, 2:]) + width_px
    for top in range(0, page.height, _TILE_PX):
        across = np.flatnonzero((high[:, 1] >= top) & (low[:, 1] < top + _TILE_PX))
        for left in range(0, page.width, _TILE_PX) if len(across) else ():
            inside = across[(high[across, 0] >= left) & (low[across, 0] < left + _TILE_PX)]
            if len(inside):
                ends = np.rint((segments[inside] - [left, top, left, top]) * _FINE).astype(np.int64)
                chosen = [colours[k] for k in inside.tolist()]
                _enlarged(page, left, top, _segments(ends.tolist(), chosen, width_px * _FINE))


def disc(page: Image.Image, centre: tuple[float, float], radius_px: float, fill: Colour, rim: Colour) -> None:
    """Paint a disc whose outer 30 % are a rim of another colour; `centre` in px of the page."""
    left, top = int(centre[0] - radius_px) - 2, int(centre[1] - radius_px) - 2
    x, y = (centre[0] - left) * _FINE, (centre[1] - top) * _FINE

    def paint(draw: ImageDraw.ImageDraw) -> None:
        for colour, radius in ((rim, radius_px * _FINE), (fill, 0.7 * radius_px * _FINE)):
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)

    _enlarged(page, left, top, paint, int(2 * radius_px) + 5)


def _segments(ends: list[list[int]], colours: list[Colour], width: float) -> Callable[[ImageDraw.ImageDraw], None]:
    # An odd width has a middle subpixel, about which the line and its round end are both exactly centred.
    radius = round(0.5 * (width - 1))

    def paint(draw: ImageDraw.ImageDraw) -> None:
        for (x0, y0, x1, y1), colour in zip(ends, colours, strict=True):
            draw.line((x0, y0, x1, y1), fill=colour, width=2 * radius + 1)
            draw.ellipse((x1 - radius, y1 - radius, x1 + radius, y1 + radius), fill=colour)

    return paint


def _enlarged(
    page: Image.Image, left: int, top: int, paint: Callable[[ImageDraw.ImageDraw], None], side: int = _TILE_PX
) -> None:
    box = (left, top, left + side, top + side)
    tile = page.crop(box).resize((side * _FINE, side * _FINE), Image.Resampling.NEAREST)
    paint(ImageDraw.Draw(tile))
    page.paste(tile.reduce(_FINE), box)
