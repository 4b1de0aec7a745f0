"""The footer of a picture, and its parts: caption, scale bar, keys to the colours of time and of lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from PIL import Image, ImageDraw

from gridslam.types import Trajectory
from gridslam.viz.layout import (
    KEY_GAP,
    MARGIN,
    SCALE_WIDTH,
    TEXT_LINE,
    TEXT_SIZE,
    TIME_WIDTH,
    TITLE_LINE,
    TITLE_SIZE,
    Layout,
    font,
)
from gridslam.viz.palette import FAINT, FREE, OCCUPIED, RULE, TIME_ENDS, UNKNOWN, Colour, time_colours
from gridslam.viz.strokes import disc

__all__ = [
    "Key", "paint_caption", "paint_footer", "paint_keys", "paint_scale", "paint_time_key", "round_length"
]  # fmt: skip

Key: TypeAlias = tuple[str, Colour]
"""What lines of a colour mean."""


def round_length(limit_m: float) -> float:
    """Greatest length of the series 1, 2, 5, 10, 20, ... (and its tenths, hundredths, ...) m that is <= `limit_m`."""
    power = 10.0 ** math.floor(math.log10(limit_m))
    return max(step * power for step in (1, 2, 5) if step * power <= limit_m)


def paint_footer(
    page: Image.Image,
    layout: Layout,
    title: str,
    caption: Sequence[str],
    trajectory: Trajectory | None,
    keys: Sequence[Key],
    stamped: bool = True,
) -> None:
    """Paint the caption at the left and the keys to scale, time and lines at the right, under a thin line.

    If stamps only count the steps, no time is shown.
    """
    u, draw = layout.unit, ImageDraw.Draw(page)
    margin = round(MARGIN * u)
    left, right, rule = margin, page.width - margin, layout.map_box[3] + margin
    draw.rectangle((0, rule, *page.size), fill=UNKNOWN)  # a path may lead off the map
    draw.line((left, rule, right, rule), fill=RULE, width=round(u))
    top = rule + margin // 2
    paint_caption(draw, left, top, title, caption, u)
    paint_keys(draw, right, top, keys, u)
    if trajectory is not None and len(trajectory):
        last = f"end, {_duration(float(np.ptp(trajectory.stamps_ns)) * 1e-9)}" if stamped else "end"
        paint_time_key(page, right, top, ("start", last), u)
        right -= round((TIME_WIDTH + KEY_GAP) * u)
    paint_scale(draw, right, top, layout.px_per_m, u)


def paint_caption(draw: ImageDraw.ImageDraw, left: int, top: int, title: str, lines: Sequence[str], u: float) -> None:
    """Paint a title, if there is one, and lines of text under it."""
    if title:
        draw.text((left, top + 24 * u), title, fill=OCCUPIED, font=font(TITLE_SIZE, u), anchor="ls")
        top += round(TITLE_LINE * u)
    for k, line in enumerate(lines):
        draw.text((left, top + (TEXT_LINE * k + 14) * u), line, fill=FAINT, font=font(TEXT_SIZE, u), anchor="ls")


def paint_scale(draw: ImageDraw.ImageDraw, right: int, top: int, px_per_m: float, u: float) -> None:
    """Paint a bar as long as a round length, one half light, that ends at `right`."""
    length_m = round_length(SCALE_WIDTH * u / px_per_m)
    length, height, rim = round(length_m * px_per_m), round(10 * u), round(2 * u)
    left, bottom = right - length, top + height - 1
    draw.rectangle((left, top, right - 1, bottom), fill=OCCUPIED)
    draw.rectangle((left + length // 2, top + rim, right - 1 - rim, bottom - rim), fill=FREE)
    label = f"{length_m:g} m" if length_m >= 1 else f"{100 * length_m:g} cm"
    _label(draw, left, right, top, ("0", label), u)


def paint_time_key(page: Image.Image, right: int, top: int, ends: tuple[str, str], u: float) -> None:
    """Paint a bar of the colours of time with the marks of start and end, and what these are."""
    width, height = round(TIME_WIDTH * u), round(10 * u)
    left = right - width
    colours = np.array([time_colours(np.linspace(0.0, 1.0, width))], dtype=np.uint8)
    page.paste(Image.fromarray(colours).resize((width, height)), (left, top))
    middle, radius = top + height / 2, 8 * u
    disc(page, (left + radius, middle), radius, FREE, TIME_ENDS[0])
    disc(page, (right - radius, middle), radius, TIME_ENDS[1], OCCUPIED)
    _label(ImageDraw.Draw(page), left, right, top, ends, u)


def paint_keys(draw: ImageDraw.ImageDraw, right: int, top: int, keys: Sequence[Key], u: float) -> None:
    """Paint below the other keys a row of what lines mean, each after a sample of its colour."""
    base, sample, gap = top + 70 * u, round(30 * u), round(10 * u)
    for name, colour in reversed(keys):
        draw.text((right, base), name, fill=FAINT, font=font(TEXT_SIZE, u), anchor="rs")
        right -= round(font(TEXT_SIZE, u).getlength(name)) + gap
        middle = base - round(6.5 * u)
        draw.rectangle((right - sample, middle - 2 * u, right, middle + 2 * u), fill=colour)
        right -= sample + 3 * gap


def _label(draw: ImageDraw.ImageDraw, left: int, right: int, top: int, texts: tuple[str, str], u: float) -> None:
    """Write under both ends of a bar."""
    for x, text, anchor in zip((left, right), texts, ("ls", "rs"), strict=True):
        draw.text((x, top + 38 * u), text, fill=FAINT, font=font(TEXT_SIZE, u), anchor=anchor)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours}:{minutes:02}:{rest:02} h"
    return f"{minutes}:{rest:02} min" if minutes else f"{rest} s"
