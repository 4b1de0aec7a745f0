"""Charts: lines, dots and bars over labelled axes, with a caption below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, TypeAlias, final

import numpy as np
from PIL import Image, ImageDraw

from gridslam.types import FloatArray
from gridslam.viz.footer import paint_caption
from gridslam.viz.layout import MARGIN, TEXT_LINE, TEXT_SIZE, TITLE_LINE, font
from gridslam.viz.palette import CLOSURE, FAINT, FREE, OCCUPIED, RULE, TIME_ENDS, TRUTH, UNKNOWN, Colour
from gridslam.viz.strokes import stroke

__all__ = ["Chart", "ChartMark", "ChartSeries", "draw_chart"]

_WIDTH, _HEIGHT = 1400, 620  # of the page and of what is drawn, px
_LEFT, _RIGHT, _TOP, _BOTTOM = 130, 50, 90, 90  # around what is drawn
_COLOURS: tuple[Colour, ...] = (OCCUPIED, CLOSURE, TRUTH, TIME_ENDS[0])
_MARK = TIME_ENDS[1]
_TICKS = 8
_DOTS = 6000  # more cannot be distinguished


_Label: TypeAlias = tuple[tuple[float, float], str, str]


class ChartSeries(Protocol):
    """Points (K,) and (K,), joined by a "line", or drawn as "dots" or as "bars" from zero."""

    @property
    def name(self) -> str:
        """What it is."""

    @property
    def x(self) -> FloatArray:
        """Across."""

    @property
    def y(self) -> FloatArray:
        """Up."""

    @property
    def style(self) -> str:
        """How it is drawn."""


class ChartMark(Protocol):
    """A line across the chart at a value of the axis "x" or "y"."""

    @property
    def name(self) -> str:
        """What it means."""

    @property
    def value(self) -> float:
        """Where it is."""

    @property
    def axis(self) -> str:
        """Of which axis."""


class Chart(Protocol):
    """What is drawn."""

    @property
    def title(self) -> str:
        """What it is about."""

    @property
    def x_label(self) -> str:
        """What goes across, with its unit."""

    @property
    def y_label(self) -> str:
        """What goes up, with its unit."""

    @property
    def series(self) -> Sequence[ChartSeries]:
        """Later ones cover earlier ones."""

    @property
    def marks(self) -> Sequence[ChartMark]:
        """Limits and measured values."""

    @property
    def equal(self) -> bool:
        """Whether both axes have the same scale."""


@final
@dataclass(frozen=True, slots=True)
class _Axes:
    """From values to pixels of the page."""

    low: FloatArray
    high: FloatArray
    box: tuple[int, int, int, int]

    def pixels(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Page coordinates (K, 2)."""
        left, top, right, bottom = self.box
        share = (np.stack([x, y], axis=1) - self.low) / (self.high - self.low)
        return np.stack([left + share[:, 0] * (right - left), bottom - share[:, 1] * (bottom - top)], axis=1)


def draw_chart(chart: Chart, *, caption: Sequence[str] = ()) -> Image.Image:
    """Draw a chart, and under it lines of text, wrapped to its width.

    Values that are not finite are left out.

    Returns
    -------
    PIL.Image.Image
        RGB, 1400 px wide.
    """
    lines = [part for line in caption for part in _wrapped(line, _WIDTH - 2 * MARGIN)]
    bottom = _TOP + _HEIGHT
    height = bottom + _BOTTOM + (TEXT_LINE * len(lines) + MARGIN if lines else 0)
    page = Image.new("RGB", (_WIDTH, height), UNKNOWN)
    axes = _axes(chart, (_LEFT, _TOP, _WIDTH - _RIGHT, bottom))
    draw = ImageDraw.Draw(page)
    draw.rectangle(axes.box, fill=FREE)
    _paint_ticks(draw, axes)
    inside = page.crop(axes.box)
    shifted = _Axes(axes.low, axes.high, (0, 0, inside.width, inside.height))
    names = _paint_marks(inside, chart.marks, shifted)
    for k, series in enumerate(chart.series):
        _paint_series(inside, series, shifted, _COLOURS[k % len(_COLOURS)])
    for at, anchor, name in names:
        _paint_label(ImageDraw.Draw(inside), at, anchor, name)
    page.paste(inside, axes.box)
    _paint_words(draw, chart, axes)
    paint_caption(draw, MARGIN, bottom + _BOTTOM, "", lines, 1.0)
    return page


def _axes(chart: Chart, box: tuple[int, int, int, int]) -> _Axes:
    """Limits of both axes: all finite values and marks, and some room about them; bars and lines show zero."""
    ranges = []
    for axis, name in enumerate(("x", "y")):
        parts = [getattr(series, name) for series in chart.series]
        parts += [np.array([mark.value for mark in chart.marks if mark.axis == name])]
        values = np.concatenate(parts)
        values = values[np.isfinite(values)]
        low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 1.0)
        if axis and not chart.equal:
            low, high = min(low, 0.0), max(high, 0.0)
        room = 0.04 * (high - low) or 0.5 * abs(high) or 1.0
        ranges.append((low - room * (low != 0 or not axis), high + room))
    (x0, x1), (y0, y1) = ranges
    if chart.equal:
        scale = max((x1 - x0) / (box[2] - box[0]), (y1 - y0) / (box[3] - box[1]))
        middle = 0.5 * np.array([x0 + x1, y0 + y1])
        half = 0.5 * scale * np.array([box[2] - box[0], box[3] - box[1]])
        return _Axes(middle - half, middle + half, box)
    return _Axes(np.array([x0, y0]), np.array([x1, y1]), box)


def _ticks(low: float, high: float) -> FloatArray:
    """Round values from `low` to `high`, 4 to 8 of them."""
    rough = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough)
    return step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1, dtype=np.float64)


def _paint_ticks(draw: ImageDraw.ImageDraw, axes: _Axes) -> None:
    """Paint a faint grid, and its values beside it."""
    left, top, right, bottom = axes.box
    letters = font(TEXT_SIZE, 1.0)
    for value in _ticks(axes.low[0], axes.high[0]).tolist():
        x = float(axes.pixels(np.array([value]), axes.low[1:])[0, 0])
        draw.line((x, top, x, bottom), fill=RULE)
        draw.text((x, bottom + 24), f"{value:.10g}", fill=FAINT, font=letters, anchor="ms")
    for value in _ticks(axes.low[1], axes.high[1]).tolist():
        y = float(axes.pixels(axes.low[:1], np.array([value]))[0, 1])
        draw.line((left, y, right, y), fill=RULE)
        draw.text((left - 12, y + 6), f"{value:.6g}", fill=FAINT, font=letters, anchor="rs")


def _paint_series(page: Image.Image, series: ChartSeries, axes: _Axes, colour: Colour) -> None:
    known = np.isfinite(series.x) & np.isfinite(series.y)
    x, y = series.x[known], series.y[known]
    if series.style == "bars":
        base, ends = axes.pixels(x, np.zeros(len(x))), axes.pixels(x, y)
        apart = float(np.diff(np.sort(base[:, 0])).min()) if len(x) > 1 else 40.0
        half = max(0.5, min(0.4 * apart, 40.0))
        draw = ImageDraw.Draw(page)
        for (at, foot), (_, head) in zip(base.tolist(), ends.tolist(), strict=True):
            draw.rectangle((at - half, min(foot, head), at + half, max(foot, head)), fill=colour)
    elif series.style == "dots":
        each = -(-len(x) // _DOTS) or 1
        places = axes.pixels(x[::each], y[::each])
        stroke(page, np.tile(places, 2), [colour] * len(places), 5.0)
    else:
        places = axes.pixels(x, y)
        stroke(page, np.concatenate([places[:-1], places[1:]], axis=1), [colour] * (len(places) - 1), 2.0)


def _paint_marks(page: Image.Image, marks: Sequence[ChartMark], axes: _Axes) -> list[_Label]:
    """Paint lines across; give the place, anchor and text of each one's name, for what is to cover all else."""
    names: list[_Label] = []
    for k, mark in enumerate(marks):
        if mark.axis == "x":
            x = float(axes.pixels(np.array([mark.value]), axes.low[1:])[0, 0])
            stroke(page, np.array([[x, 0.0, x, page.height]]), [_MARK], 2.0)
            left = x > 0.7 * page.width
            names.append(((x - 10 if left else x + 10, 26 + TEXT_LINE * k), "rs" if left else "ls", mark.name))
        else:
            y = float(axes.pixels(axes.low[:1], np.array([mark.value]))[0, 1])
            stroke(page, np.array([[0.0, y, page.width, y]]), [_MARK], 2.0)
            names.append(((page.width - 10, max(y - 10, 26)), "rs", mark.name))
    return names


def _paint_label(draw: ImageDraw.ImageDraw, at: tuple[float, float], anchor: str, name: str) -> None:
    """Paint a name on a ground of its own."""
    letters = font(TEXT_SIZE, 1.0)
    left, top, right, bottom = draw.textbbox(at, name, font=letters, anchor=anchor)
    draw.rectangle((left - 4, top - 3, right + 4, bottom + 3), fill=FREE)
    draw.text(at, name, fill=OCCUPIED, font=letters, anchor=anchor)


def _paint_words(draw: ImageDraw.ImageDraw, chart: Chart, axes: _Axes) -> None:
    """Paint the title, what the axes are, and a key where there are several series."""
    left, top, right, bottom = axes.box
    paint_caption(draw, left, top - TITLE_LINE - 26, chart.title, (), 1.0)
    letters = font(TEXT_SIZE, 1.0)
    draw.text((left, top - 12), chart.y_label, fill=FAINT, font=letters, anchor="ls")
    draw.text((right, bottom + 54), chart.x_label, fill=FAINT, font=letters, anchor="rs")
    if len(chart.series) < 2:
        return
    for k, series in reversed(list(enumerate(chart.series))):
        draw.text((right, top - 12), series.name, fill=FAINT, font=letters, anchor="rs")
        right -= round(letters.getlength(series.name)) + 10
        draw.rectangle((right - 30, top - 20, right, top - 16), fill=_COLOURS[k % len(_COLOURS)])
        right -= 60


def _wrapped(line: str, width: float) -> list[str]:
    """Parts of a line that fit the width, broken between words."""
    letters, parts = font(TEXT_SIZE, 1.0), [""]
    for word in line.split():
        longer = f"{parts[-1]} {word}".strip()
        if letters.getlength(longer) <= width:
            parts[-1] = longer
        else:
            parts.append(word)
    return parts
