"""Charts of the doctor's figures: lines, dots and bars over labelled axes, with a caption below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import TypeVar, final

import numpy as np
from PIL import Image, ImageDraw

from gridslam.doctor.finding import Figure, Mark, Series
from gridslam.types import FloatArray
from gridslam.viz.canvas import (
    CLOSURE,
    FAINT,
    FREE,
    MARGIN,
    OCCUPIED,
    RULE,
    TEXT_LINE,
    TEXT_SIZE,
    TIME_ENDS,
    TITLE_LINE,
    TRUTH,
    UNKNOWN,
    Colour,
    dots,
    font,
    paint_caption,
    stroke,
)

__all__ = ["draw_chart"]

_WIDTH = 1220  # of what is drawn, px
_HEIGHT = 620
_LEFT = 130  # around it on the page
_RIGHT = 50
_TOP = 90
_BOTTOM = 90
_COLOURS: tuple[Colour, ...] = (OCCUPIED, CLOSURE, TRUTH, TIME_ENDS[0])
_MARK = TIME_ENDS[1]
_TICKS = 8
_DOTS = 6000  # more cannot be distinguished

_Values = TypeVar("_Values", float, FloatArray)


@final
@dataclass(frozen=True, slots=True)
class _Axis:
    """Maps values to pixels: `low` to `first_px`, `high` to `last_px`."""

    low: float
    high: float
    first_px: float
    last_px: float

    @classmethod
    def of(cls, figure: Figure, name: str, first_px: float, last_px: float) -> _Axis:
        """Show all finite values and marks, and some room about them; y shows zero."""
        parts = [getattr(series, name) for series in figure.series]
        values = np.concatenate([*parts, [mark.value for mark in figure.marks if mark.axis == name]])
        values = values[np.isfinite(values)]
        if name == "y":
            values = np.append(values, 0.0)
        low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
        room = 0.04 * (high - low) or 0.5 * abs(high) or 1.0
        return cls(low if name == "y" and low == 0 else low - room, high + room, first_px, last_px)

    def at(self, values: _Values) -> _Values:
        """Return pixels (K,) of values (K,), or of one."""
        return self.first_px + (values - self.low) / (self.high - self.low) * (self.last_px - self.first_px)

    def ticks(self) -> list[float]:
        """Round values, 4 to 8 of them."""
        rough = (self.high - self.low) / _TICKS
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
        return [step * k for k in range(math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9) + 1)]


def draw_chart(figure: Figure, *, caption: Sequence[str] = ()) -> Image.Image:
    """Draw a chart, and under it lines of text, wrapped to its width.

    Values that are not finite are left out.

    Returns
    -------
    PIL.Image.Image
        RGB, 1400 px wide.
    """
    width = _LEFT + _WIDTH + _RIGHT
    lines = [part for line in caption for part in _wrapped(line, width - 2 * MARGIN)]
    bottom = _TOP + _HEIGHT + _BOTTOM
    page = Image.new("RGB", (width, bottom + (TEXT_LINE * len(lines) + MARGIN if lines else 0)), UNKNOWN)
    inside = Image.new("RGB", (_WIDTH, _HEIGHT), FREE)
    x = _Axis.of(figure, "x", 0, _WIDTH)
    y = _Axis.of(figure, "y", _HEIGHT, 0)
    draw = ImageDraw.Draw(page)
    _paint_ticks(draw, ImageDraw.Draw(inside), x, y)
    for mark in figure.marks:
        at = x.at(mark.value) if mark.axis == "x" else y.at(mark.value)
        stroke(inside, np.array([[at, 0.0, at, _HEIGHT] if mark.axis == "x" else [0.0, at, _WIDTH, at]]), _MARK, 2.0)
    for series, colour in zip(figure.series, cycle(_COLOURS), strict=False):
        _paint_series(inside, series, x, y, colour)
    for k, mark in enumerate(figure.marks):
        _paint_name(ImageDraw.Draw(inside), mark, x, y, k)
    page.paste(inside, (_LEFT, _TOP))
    _paint_words(draw, figure)
    paint_caption(draw, MARGIN, bottom, "", lines, 1.0)
    return page


def _paint_ticks(draw: ImageDraw.ImageDraw, inside: ImageDraw.ImageDraw, x: _Axis, y: _Axis) -> None:
    """Paint a faint grid, and its values beside it."""
    letters = font(TEXT_SIZE, 1.0)
    for value in x.ticks():
        at = x.at(value)
        inside.line((at, 0, at, _HEIGHT), fill=RULE)
        draw.text((_LEFT + at, _TOP + _HEIGHT + 24), f"{value:.10g}", fill=FAINT, font=letters, anchor="ms")
    for value in y.ticks():
        at = y.at(value)
        inside.line((0, at, _WIDTH, at), fill=RULE)
        draw.text((_LEFT - 12, _TOP + at + 6), f"{value:.6g}", fill=FAINT, font=letters, anchor="rs")


def _paint_series(page: Image.Image, series: Series, x: _Axis, y: _Axis, colour: Colour) -> None:
    known = np.isfinite(series.x) & np.isfinite(series.y)
    points = np.stack([x.at(series.x[known]), y.at(series.y[known])], axis=1)
    if series.style == "bars":
        zero = y.at(0.0)
        apart = float(np.diff(np.sort(points[:, 0])).min()) if len(points) > 1 else 40.0
        half = max(0.5, min(0.4 * apart, 40.0))
        draw = ImageDraw.Draw(page)
        for at, head in points.tolist():
            draw.rectangle((at - half, min(zero, head), at + half, max(zero, head)), fill=colour)
    elif series.style == "dots":
        dots(page, points[:: -(-len(points) // _DOTS) or 1], colour, 5.0)
    else:
        stroke(page, np.concatenate([points[:-1], points[1:]], axis=1), colour, 2.0)


def _paint_name(draw: ImageDraw.ImageDraw, mark: Mark, x: _Axis, y: _Axis, row: int) -> None:
    """Paint the name of a mark beside it, on a ground of its own that covers all else."""
    anchor = "rs"
    if mark.axis == "y":
        at = (_WIDTH - 10.0, max(y.at(mark.value) - 10, 26.0))
    elif x.at(mark.value) > 0.7 * _WIDTH:
        at = (x.at(mark.value) - 10, 26.0 + TEXT_LINE * row)
    else:
        anchor = "ls"
        at = (x.at(mark.value) + 10, 26.0 + TEXT_LINE * row)
    letters = font(TEXT_SIZE, 1.0)
    left, top, right, bottom = draw.textbbox(at, mark.name, font=letters, anchor=anchor)
    draw.rectangle((left - 4, top - 3, right + 4, bottom + 3), fill=FREE)
    draw.text(at, mark.name, fill=OCCUPIED, font=letters, anchor=anchor)


def _paint_words(draw: ImageDraw.ImageDraw, figure: Figure) -> None:
    """Paint the title, the labels of the axes, and a key where there are several series."""
    right = _LEFT + _WIDTH
    letters = font(TEXT_SIZE, 1.0)
    paint_caption(draw, _LEFT, _TOP - TITLE_LINE - 26, figure.title, (), 1.0)
    draw.text((_LEFT, _TOP - 12), figure.y_label, fill=FAINT, font=letters, anchor="ls")
    draw.text((right, _TOP + _HEIGHT + 54), figure.x_label, fill=FAINT, font=letters, anchor="rs")
    for k, series in reversed(list(enumerate(figure.series if len(figure.series) > 1 else ()))):
        draw.text((right, _TOP - 12), series.name, fill=FAINT, font=letters, anchor="rs")
        right -= round(letters.getlength(series.name)) + 10
        draw.rectangle((right - 30, _TOP - 20, right, _TOP - 16), fill=_COLOURS[k % len(_COLOURS)])
        right -= 60


def _wrapped(line: str, width: float) -> list[str]:
    """Return parts of a line that fit the width, broken between words."""
    letters = font(TEXT_SIZE, 1.0)
    parts = [""]
    for word in line.split():
        longer = f"{parts[-1]} {word}".strip()
        if letters.getlength(longer) <= width:
            parts[-1] = longer
        else:
            parts.append(word)
    return parts
