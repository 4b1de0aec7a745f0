"""Where things are on the page: the map at the top, under it a footer with caption and keys."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray
from PIL import ImageFont

from gridslam.types import FloatArray, GridRows

__all__ = [
    "KEY_GAP", "MARGIN", "SCALE_WIDTH", "TEXT_LINE", "TEXT_SIZE", "TIME_WIDTH", "TITLE_LINE", "TITLE_SIZE", "Layout",
    "font", "footer_size", "lay_out",
]  # fmt: skip

MARGIN, TITLE_SIZE, TITLE_LINE, TEXT_SIZE, TEXT_LINE = 50, 30, 44, 19, 28  # in units of the layout, as are these:
SCALE_WIDTH, TIME_WIDTH, KEY_GAP, _KEY_HEIGHT = 280, 280, 60, 80

_MAP_SIDE_PX = (1300, 3200)  # the map's long side; with margins and footer the page is 1400 to 4000
_MAP_AREA_PX = 7_000_000  # Pillow keeps 4 bytes a pixel: a page of 30 MB
_ROWS = 64  # rows of cells looked at a time
_CELL_PX = 64  # cells are not enlarged further
_PAGE_SIDE_PX = 1400


@final
@dataclass(frozen=True, slots=True)
class Layout:
    """Where things are on the page; lengths in px, x to the right and y down.

    Attributes
    ----------
    rows, columns : slice
        The cells shown.
    size : (int, int)
        Width and height of the page.
    map_box : (int, int, int, int)
        Left, top, right, bottom of the map.
    px_per_m : float
    left_m, top_m : float, m
        World coordinates of the map's upper left corner.
    unit : float
        Factor on all sizes of text and lines: 1 for a page of 1400 px.
    """

    rows: slice
    columns: slice
    size: tuple[int, int]
    map_box: tuple[int, int, int, int]
    px_per_m: float
    left_m: float
    top_m: float
    unit: float

    def pixels(self, points: FloatArray) -> FloatArray:
        """Page coordinates (N, 2) in px of world points (N, 2) in m."""
        x = self.map_box[0] + (points[:, 0] - self.left_m) * self.px_per_m
        y = self.map_box[1] + (self.top_m - points[:, 1]) * self.px_per_m
        return np.stack([x, y], axis=1)


def lay_out(grid: GridRows, title: str = "", caption: Sequence[str] = ()) -> Layout:
    """Decide what part of the grid is shown, how large, and where; a grid without a known cell is shown whole."""
    rows, columns = _known_part(grid)
    height, width = rows.stop - rows.start, columns.stop - columns.start
    least, most = _MAP_SIDE_PX
    scale = min(math.ceil(least / max(height, width)), _CELL_PX)
    scale_limit = min(most / max(height, width), math.sqrt(_MAP_AREA_PX / (height * width)))
    fitted = min(float(scale), scale_limit)
    map_size = max(1, round(width * fitted)), max(1, round(height * fitted))
    unit = max(1.0, max(map_size) / least)
    margin = round(MARGIN * unit)
    footer = footer_size(title, caption, unit)
    keys_px = round((SCALE_WIDTH + KEY_GAP + TIME_WIDTH) * unit)
    page_width = max(map_size[0] + 2 * margin, footer[0] + keys_px + 3 * margin)
    page_height = map_size[1] + 3 * margin + footer[1]
    if max(page_width, page_height) < _PAGE_SIDE_PX:
        page_width = _PAGE_SIDE_PX
    left = (page_width - map_size[0]) // 2
    return Layout(
        rows=rows,
        columns=columns,
        size=(page_width, page_height),
        map_box=(left, margin, left + map_size[0], margin + map_size[1]),
        px_per_m=fitted / grid.resolution_m,
        left_m=grid.origin[0] + columns.start * grid.resolution_m,
        top_m=grid.origin[1] + rows.stop * grid.resolution_m,
        unit=unit,
    )


def footer_size(title: str, caption: Sequence[str], unit: float) -> tuple[int, int]:
    """Width of the caption in px, and height that it and the keys beside it need."""
    lengths = [font(TEXT_SIZE, unit).getlength(line) for line in caption] + [font(TITLE_SIZE, unit).getlength(title)]
    height = max(_KEY_HEIGHT, TITLE_LINE * bool(title) + TEXT_LINE * len(caption))
    return math.ceil(max(lengths)), round(unit * height)


def _known_part(grid: GridRows) -> tuple[slice, slice]:
    """The rows and columns from the first to the last with a known cell; all of them, where there is none."""
    height, width = grid.shape
    in_row, in_column = np.zeros(height, np.bool_), np.zeros(width, np.bool_)
    for top in range(0, height, _ROWS):
        known = grid.rows(top, min(top + _ROWS, height)).known
        in_row[top : top + _ROWS] = known.any(axis=1)
        in_column |= known.any(axis=0)
    return _extent(in_row), _extent(in_column)


def _extent(known: NDArray[np.bool_]) -> slice:
    """From the first to the last that is known; at least one long."""
    found = np.flatnonzero(known)
    return slice(int(found[0]), int(found[-1]) + 1) if len(found) else slice(0, max(1, len(known)))


@functools.lru_cache(maxsize=8)
def font(size: float, unit: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own typeface at a size in units of the layout: nothing to install, and the same on every machine."""
    return ImageFont.load_default(size=size * unit)
