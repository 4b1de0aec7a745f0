"""Tools of all pictures: colours, letters, pages, antialiased strokes, paths, and the footer."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from gridslam.types import FloatArray, Trajectory

Colour: TypeAlias = tuple[int, int, int]

# A quiet map in neutral tones, so that the trajectory has the colour to itself.
UNKNOWN: Colour = (226, 229, 232)
FREE: Colour = (253, 253, 252)
OCCUPIED: Colour = (34, 41, 54)
FAINT: Colour = (104, 113, 126)
RULE: Colour = (196, 201, 207)
TRUTH: Colour = (0, 150, 136)
CLOSURE: Colour = (30, 136, 210)
REJECTED: Colour = (160, 167, 176)
LOST: Colour = (214, 40, 40)

# From early to late: lightness (CIE L*) rises evenly from 22 to 73 while the hue turns from violet to orange, so the
# order can be read in grey as well, and the lightest colour still stands out from white.
_TIME_STOPS: tuple[Colour, ...] = (
    (62, 24, 138), (121, 28, 152), (174, 38, 132), (214, 69, 97), (238, 112, 62), (247, 160, 40)
)  # fmt: skip
TIME_ENDS = (_TIME_STOPS[0], _TIME_STOPS[-1])

MARGIN = 50  # in units of a layout, as are those that follow
TEXT_SIZE = 19
TEXT_LINE = 28
TITLE_LINE = 44
_TITLE_SIZE = 30
_KEY_WIDTH = 280  # of the scale, and of the key to the colours of time
_KEY_GAP = 60
_KEY_HEIGHT = 80
_KEY_BASE = 70  # of the first row of names
_SAMPLE = 70  # of a key's colour, with the gaps
_LONGEST_TITLE = 900
_FEWEST_LETTERS = 6  # to which a name is cut

_PLANE_SIDE_PX = 1600  # the long side of a picture without a map
_PAGE_SIDE_PX = 1400  # the long side of a page is no shorter
_FINE = 3  # subpixels a side: 10 levels of coverage
_TILE_PX = 192  # a tile of the page, 1.3 MB when enlarged
_NODE_PX = 3.0  # a path is thinned to nodes this far apart


@final
@dataclass(frozen=True, slots=True)
class Layout:
    """Where a part of the plane is on a page; lengths in px, x to the right and y down.

    Attributes
    ----------
    size : (int, int)
        Width and height of the page.
    map_box : (int, int, int, int)
        Left, top, right, bottom of what shows the plane.
    px_per_m : float
    left_m, top_m : float, m
        World coordinates of the upper left corner of `map_box`.
    unit : float
        Factor on all sizes of text and lines: 1 for a page of 1400 px.
    """

    size: tuple[int, int]
    map_box: tuple[int, int, int, int]
    px_per_m: float
    left_m: float
    top_m: float
    unit: float

    @classmethod
    def of(cls, low: FloatArray, high: FloatArray, px_per_m: float, title: str, caption: Sequence[str]) -> Layout:
        """Place the part of the plane from `low` (2,) to `high` (2,), m, above a footer."""
        width, height = (max(1, round(side)) for side in ((high - low) * px_per_m).tolist())
        unit = max(1.0, max(width, height) / 1300)
        margin = round(MARGIN * unit)
        lengths = [font(TEXT_SIZE, unit).getlength(line) for line in caption]
        lengths.append(min(font(_TITLE_SIZE, unit).getlength(title), _LONGEST_TITLE * unit))  # a longer one is cut
        keys = round((2 * _KEY_WIDTH + _KEY_GAP) * unit)
        footer = round(unit * max(_KEY_HEIGHT, TITLE_LINE * bool(title) + TEXT_LINE * len(caption)))
        page_width = max(width + 2 * margin, math.ceil(max(lengths)) + keys + 3 * margin)
        page_height = height + 3 * margin + footer
        if max(page_width, page_height) < _PAGE_SIDE_PX:
            page_width = _PAGE_SIDE_PX
        left = (page_width - width) // 2
        box = (left, margin, left + width, margin + height)
        return cls((page_width, page_height), box, px_per_m, float(low[0]), float(high[1]), unit)

    def pixels(self, points: FloatArray) -> FloatArray:
        """Page coordinates (N, 2) in px of world points (N, 2) in m."""
        x = self.map_box[0] + (points[:, 0] - self.left_m) * self.px_per_m
        y = self.map_box[1] + (self.top_m - points[:, 1]) * self.px_per_m
        return np.stack([x, y], axis=1)


def open_page(points: FloatArray, title: str, caption: Sequence[str]) -> tuple[Image.Image, Layout]:
    """Return a page with an empty part of the plane about points (N, 2), m, and its layout."""
    low = points.min(axis=0)
    high = np.maximum(points.max(axis=0), low + 1e-3)
    border = 0.05 * float((high - low).max())
    layout = Layout.of(low - border, high + border, _PLANE_SIDE_PX / (22 * border), title, caption)
    page = Image.new("RGB", layout.size, UNKNOWN)
    page.paste(FREE, layout.map_box)
    return page, layout


def time_colours(shares: FloatArray) -> list[Colour]:
    """Return colours of times (K,) in [0, 1], from early to late."""
    at = np.linspace(0.0, 1.0, len(_TIME_STOPS))
    channels = [np.interp(shares, at, stops).astype(int).tolist() for stops in np.array(_TIME_STOPS).T]
    return list(zip(*channels, strict=True))


@functools.lru_cache(maxsize=8)
def font(size: float, unit: float) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    """Pillow's own typeface at a size in units of the layout: nothing to install, and the same on every machine."""
    return ImageFont.load_default(size=size * unit)


def stroke(page: Image.Image, segments: FloatArray, colours: Colour | list[Colour], width_px: float) -> None:
    """Paint segments with a round end each, so that the segments of a path join smoothly.

    They are antialiased: a tile of the page is enlarged, painted on with hard edges, and reduced again.

    Parameters
    ----------
    page : Image, RGB
        Painted on; what lies outside of it is cut off.
    segments : (K, 4) float64, px
        [x0, y0, x1, y1] on the page, x to the right and y down.
    colours : (r, g, b), or list of K of them
        Later segments cover earlier ones.
    width_px : float, px, > 0
    """
    low = np.minimum(segments[:, :2], segments[:, 2:]) - width_px
    high = np.maximum(segments[:, :2], segments[:, 2:]) + width_px
    radius = round(0.5 * (width_px * _FINE - 1))  # an odd width has a middle subpixel: line and end are centred on it
    for top in range(0, page.height, _TILE_PX):
        across = np.flatnonzero((high[:, 1] >= top) & (low[:, 1] < top + _TILE_PX))
        for left in range(0, page.width, _TILE_PX) if len(across) else ():
            inside = across[(high[across, 0] >= left) & (low[across, 0] < left + _TILE_PX)]
            if len(inside):
                box = (left, top, left + _TILE_PX, top + _TILE_PX)
                tile = page.crop(box).resize((_TILE_PX * _FINE, _TILE_PX * _FINE), Image.Resampling.NEAREST)
                draw = ImageDraw.Draw(tile)
                ends = np.rint((segments[inside] - [left, top, left, top]) * _FINE).astype(np.int64)
                for k, (x0, y0, x1, y1) in zip(inside.tolist(), ends.tolist(), strict=True):
                    colour = colours[k] if isinstance(colours, list) else colours
                    draw.line((x0, y0, x1, y1), fill=colour, width=2 * radius + 1)
                    draw.ellipse((x1 - radius, y1 - radius, x1 + radius, y1 + radius), fill=colour)
                page.paste(tile.reduce(_FINE), box)


def dots(page: Image.Image, points: FloatArray, colours: Colour | list[Colour], width_px: float) -> None:
    """Paint round dots at points (K, 2), px."""
    stroke(page, np.tile(points, 2), colours, width_px)


def disc(page: Image.Image, points: FloatArray, radius_px: float, fill: Colour, rim: Colour) -> None:
    """Paint discs at points (K, 2), px, whose outer 30 % are a rim of another colour."""
    dots(page, points, rim, 2 * radius_px)
    dots(page, points, fill, 1.4 * radius_px)


def mark_ends(page: Image.Image, ends: FloatArray, radius_px: float) -> None:
    """Mark the first of two points (2, 2), px, by a white disc, and the second by a filled one."""
    disc(page, ends[:1], radius_px, FREE, TIME_ENDS[0])
    disc(page, ends[1:], radius_px, TIME_ENDS[1], OCCUPIED)


def paint_path(
    page: Image.Image,
    layout: Layout,
    trajectory: Trajectory,
    width: float,
    colour: Colour | None = None,
    *,
    hidden: NDArray[np.bool_] | None = None,
    jump_m: float = math.inf,
) -> None:
    """Paint a trajectory `width` units wide, in the colours of time unless a colour is given.

    Segments that end at `hidden` poses (N,), or are longer than `jump_m`, are left out.
    """
    if not len(trajectory):
        return
    points = layout.pixels(trajectory.poses[:, :2])
    hidden = np.zeros(len(points), np.bool_) if hidden is None else hidden
    changes = np.flatnonzero(np.diff(hidden))
    walked = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))]) // _NODE_PX
    nodes = np.flatnonzero(np.diff(walked, prepend=-1.0))
    kept = np.unique(np.concatenate([nodes, changes, changes + 1, [len(points) - 1]]))
    segments = np.concatenate([points[kept[:-1]], points[kept[1:]]], axis=1)
    short = np.hypot(*(segments[:, 2:] - segments[:, :2]).T) < jump_m * layout.px_per_m
    shown = short & ~hidden[kept[:-1]] & ~hidden[kept[1:]]
    passed = np.maximum.accumulate(trajectory.stamps_ns - trajectory.stamps_ns[0]).astype(np.float64)
    colours = time_colours(passed[kept[1:][shown]] / max(passed[-1], 1.0)) if colour is None else colour
    stroke(page, segments[shown], colours, width * layout.unit)


def label_time(trajectory: Trajectory, stamped: bool = True) -> tuple[str, str]:
    """Return the labels at both ends of the colours of time; without a time if stamps only count the steps."""
    seconds = round(float(np.ptp(trajectory.stamps_ns)) * 1e-9)
    minutes, rest = divmod(seconds, 60)
    if not stamped:
        return "start", "end"
    if seconds >= 3600:
        return "start", f"end, {minutes // 60}:{minutes % 60:02}:{rest:02} h"
    return "start", f"end, {minutes}:{rest:02} min" if minutes else f"end, {rest} s"


def paint_footer(
    page: Image.Image,
    layout: Layout,
    title: str,
    caption: Sequence[str],
    keys: Sequence[tuple[str, Colour]],
    ends: tuple[str, str] | None = None,
) -> None:
    """Paint under the plane a thin line, the caption at the left, and keys at the right.

    The keys are to lines, by what a colour means; to the colours of time, by what stands at their ends; and to scale.
    """
    unit = layout.unit
    draw = ImageDraw.Draw(page)
    margin = round(MARGIN * unit)
    right = page.width - margin
    rule = layout.map_box[3] + margin
    top = rule + margin // 2
    draw.rectangle((0, rule, *page.size), fill=UNKNOWN)  # a path may lead off the map
    draw.line((margin, rule, right, rule), fill=RULE, width=round(unit))
    key = round((_KEY_WIDTH + _KEY_GAP) * unit)
    _paint_caption(draw, margin, top, _cut(title, _TITLE_SIZE, right - margin - 2 * key, unit), caption, unit)
    beside = margin + max((font(TEXT_SIZE, unit).getlength(line) for line in caption), default=0.0)
    rows = max(1, (TITLE_LINE * bool(title) + TEXT_LINE * len(caption) - _KEY_BASE) // TEXT_LINE + 1)
    _paint_keys(draw, beside, right, top + _KEY_BASE * unit, rows, keys, unit)
    if ends is not None:
        _paint_time_key(page, right, top, ends, unit)
        right -= key
    _paint_scale(draw, right, top, layout.px_per_m, unit)


def _paint_caption(draw: ImageDraw.ImageDraw, left: int, top: int, title: str, lines: Sequence[str], u: float) -> None:
    """Paint a title, if there is one, and lines of text under it."""
    if title:
        draw.text((left, top + 24 * u), title, fill=OCCUPIED, font=font(_TITLE_SIZE, u), anchor="ls")
        top += round(TITLE_LINE * u)
    for k, line in enumerate(lines):
        draw.text((left, top + (TEXT_LINE * k + 14) * u), line, fill=FAINT, font=font(TEXT_SIZE, u), anchor="ls")


def _paint_scale(draw: ImageDraw.ImageDraw, right: int, top: int, px_per_m: float, u: float) -> None:
    """Paint a bar as long as a round length, one half light, that ends at `right`."""
    length_m = round_length(_KEY_WIDTH * u / px_per_m)
    length = round(length_m * px_per_m)
    rim = round(2 * u)
    left = right - length
    bottom = top + round(10 * u) - 1
    draw.rectangle((left, top, right - 1, bottom), fill=OCCUPIED)
    draw.rectangle((left + length // 2, top + rim, right - 1 - rim, bottom - rim), fill=FREE)
    label = f"{length_m:g} m" if length_m >= 1 else f"{100 * length_m:g} cm"
    _label(draw, left, right, top, ("0", label), u)


def round_length(limit_m: float) -> float:
    """Greatest length of the series 1, 2, 5, 10, 20, ... (and its tenths, hundredths, ...) m that is <= `limit_m`."""
    power = 10.0 ** math.floor(math.log10(limit_m))
    return max(step * power for step in (1, 2, 5) if step * power <= limit_m)


def _paint_time_key(page: Image.Image, right: int, top: int, ends: tuple[str, str], u: float) -> None:
    """Paint a bar of the colours of time with the marks of start and end, and their legend."""
    width = round(_KEY_WIDTH * u)
    height = round(10 * u)
    left = right - width
    colours = np.array([time_colours(np.linspace(0.0, 1.0, width))], dtype=np.uint8)
    page.paste(Image.fromarray(colours).resize((width, height)), (left, top))
    middle = top + height / 2
    mark_ends(page, np.array([[left + 8 * u, middle], [right - 8 * u, middle]]), 8 * u)
    _label(ImageDraw.Draw(page), left, right, top, ends, u)


def _cut(text: str, size: int, width: float, u: float) -> str:
    """Return a text that fits into a width, px: its end is cut off if need be."""
    letters = font(size, u)
    while len(text) > _FEWEST_LETTERS and letters.getlength(text) > width:
        text = f"{text.rstrip('…')[:-1]}…"
    return text


def _paint_keys(
    draw: ImageDraw.ImageDraw,
    left: float,
    right: float,
    top: float,
    rows: int,
    keys: Sequence[tuple[str, Colour]],
    u: float,
) -> None:
    """Paint the meanings of lines, each after a sample of its colour, in columns from the right as far as they fit."""
    letters = font(TEXT_SIZE, u)
    for first in range(0, len(keys), rows):
        column = keys[first : first + rows]
        width = max(letters.getlength(name) for name, _ in column)
        if right - width - 40 * u < left:
            return
        for k, (name, colour) in enumerate(column):
            base = top + TEXT_LINE * k * u
            draw.text((right - width, base), name, fill=FAINT, font=letters, anchor="ls")
            line = right - width - 10 * u
            draw.rectangle((line - 30 * u, base - 8.5 * u, line, base - 4.5 * u), fill=colour)
        right -= width + _SAMPLE * u


def _label(draw: ImageDraw.ImageDraw, left: int, right: int, top: int, texts: tuple[str, str], u: float) -> None:
    """Write under both ends of a bar."""
    for x, text, anchor in zip((left, right), texts, ("ls", "rs"), strict=True):
        draw.text((x, top + 38 * u), text, fill=FAINT, font=font(TEXT_SIZE, u), anchor=anchor)
