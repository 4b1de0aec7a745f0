"""Picture of a pose graph before and after optimization."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridslam.errors import ArgumentError
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray
from gridslam.viz.footer import paint_caption, paint_keys, paint_scale, paint_time_key
from gridslam.viz.layout import KEY_GAP, MARGIN, TEXT_SIZE, TIME_WIDTH, font, footer_size
from gridslam.viz.palette import CLOSURE, FREE, OCCUPIED, REJECTED, RULE, TIME_ENDS, UNKNOWN, time_colours
from gridslam.viz.strokes import disc, stroke

__all__ = ["draw_graph"]

_UNIT = 1.5  # factor on all sizes of text and lines, for a page of some 2200 px
_PAD, _HEAD, _MARGIN_PX = 24, 60, round(MARGIN * _UNIT)  # the first two in units
_SIDE_PX = 1000  # the long side of what is drawn
_SLENDER = 0.3  # a panel's short side is at least this share of its long side
_WIDE = 1.6  # panels that are wider than this times their height stand one above the other
_ALIKE = 2.0  # panels have one scale if neither is larger than this times the other


def draw_graph(
    graph: PoseGraph,
    before: FloatArray,
    *,
    rejected: NDArray[np.bool_] | None = None,
    title: str = "",
    caption: Sequence[str] = (),
    heads: tuple[str, str] = ("before", "after"),
    ends: tuple[str, str] = ("first", "last"),
) -> Image.Image:
    """Draw a graph as it was and as it is: poses coloured by their order, odometry, loop closures.

    Each of the two has its own scale bar; the scales are the same unless one is much larger than the other.

    Parameters
    ----------
    graph : PoseGraph
        As it is; its trusted edges are drawn as odometry, the others as loop closures.
    before : (N, 3) float64
        Its poses as they were.
    rejected : (M,) bool, optional
        Edges that were found to be false, drawn in a colour of their own.
    title, caption : str, sequence of str
        First line of the caption, in larger letters, and further lines.
    heads : (str, str)
        What stands above the two.
    ends : (str, str)
        Names of the first and the last pose in the key to the colours.

    Returns
    -------
    PIL.Image.Image
        RGB, its long side about 1200 to 2400 px.

    Raises
    ------
    ArgumentError
        `before` or `rejected` has not the shape that fits the graph.
    """
    if before.shape != graph.poses.shape:
        raise ArgumentError("before", f"shape {graph.poses.shape}", before.shape)
    if rejected is not None and rejected.shape != graph.trusted.shape:
        raise ArgumentError("rejected", f"shape {graph.trusted.shape}", rejected.shape)
    box, scales = _fit((before, graph.poses))
    states = zip((before, graph.poses), scales, strict=True)
    drawn = [_panel(graph, poses, rejected, box, scale) for poses, scale in states]
    page, places, rule = _page(drawn[0].size, title, caption)
    for panel, place, head, scale in zip(drawn, places, heads, scales, strict=True):
        _paint_headed(page, panel, place, head, scale)
    keys = [("loop closures", CLOSURE)] + ([("rejected", REJECTED)] if rejected is not None else [])
    left, right, top = _MARGIN_PX, page.width - _MARGIN_PX, rule + _MARGIN_PX // 2
    draw = ImageDraw.Draw(page)
    draw.line((left, rule, right, rule), fill=RULE, width=round(_UNIT))
    paint_caption(draw, left, top, title, caption, _UNIT)
    paint_time_key(page, right, top, ends, _UNIT)
    paint_keys(draw, right, top, keys, _UNIT)
    return page


def _fit(both: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Width and height of a panel's drawing in px, and the scale of each panel in px/m."""
    spans = np.array([np.ptp(poses[:, :2], axis=0) for poses in both])
    spans = np.maximum(spans, _SLENDER * np.maximum(spans.max(axis=1, keepdims=True), 1.0))
    longest = spans.max(axis=1)
    if longest.max() <= _ALIKE * longest.min():
        spans[:] = spans.max(axis=0)
    box = spans[1] * _SIDE_PX / spans[1].max()
    return box, (box / spans).min(axis=1)


def _panel(
    graph: PoseGraph, poses: FloatArray, rejected: NDArray[np.bool_] | None, box: FloatArray, px_per_m: float
) -> Image.Image:
    """Draw one state of the graph, in the middle of its panel."""
    pad = round(_PAD * _UNIT)
    width, height = np.ceil(box).astype(int).tolist()
    panel = Image.new("RGB", (width + 2 * pad, height + 2 * pad), FREE)
    middle = 0.5 * (poses[:, :2].min(axis=0) + poses[:, :2].max(axis=0))
    at = (poses[:, :2] - middle) * [px_per_m, -px_per_m] + 0.5 * np.array(panel.size)
    lines = at[graph.edges].reshape(-1, 4)
    false = np.zeros(len(lines), np.bool_) if rejected is None else rejected
    colours = time_colours(np.linspace(0.0, 1.0, len(at)))
    closures, odometry = lines[~graph.trusted & ~false], np.flatnonzero(graph.trusted & ~false)
    stroke(panel, lines[false], [REJECTED] * int(false.sum()), 1.0 * _UNIT)
    stroke(panel, closures, [CLOSURE] * len(closures), 1.2 * _UNIT)
    stroke(panel, lines[odometry], [colours[k] for k in graph.edges[odometry].max(axis=1).tolist()], 1.5 * _UNIT)
    stroke(panel, np.tile(at, 2), colours, _dot_px(lines[odometry]))
    (first, last), radius = at[[0, -1]].tolist(), 6.0 * _UNIT
    disc(panel, first, radius, FREE, TIME_ENDS[0])
    disc(panel, last, radius, TIME_ENDS[1], OCCUPIED)
    return panel


def _dot_px(odometry: FloatArray) -> float:
    """Width of a pose's dot: as large as allows neighbours to be distinguished, within limits."""
    steps = np.hypot(*(odometry[:, 2:] - odometry[:, :2]).T)
    return float(np.clip(0.5 * np.median(steps), 2.0 * _UNIT, 5.0 * _UNIT)) if len(steps) else 5.0 * _UNIT


def _page(panel: tuple[int, int], title: str, caption: Sequence[str]) -> tuple[Image.Image, list[tuple[int, int]], int]:
    """An empty page, the upper left corners of its two panels, and where the line above the footer is."""
    head, footer = round(_HEAD * _UNIT), footer_size(title, caption, _UNIT)
    wide = panel[0] > _WIDE * panel[1]
    across, down = (0, panel[1] + head + _MARGIN_PX) if wide else (panel[0] + _MARGIN_PX, 0)
    needed = footer[0] + round((KEY_GAP + TIME_WIDTH) * _UNIT)
    width = 2 * _MARGIN_PX + max(panel[0] + across, needed)
    left, top = (width - panel[0] - across) // 2, _MARGIN_PX + head
    rule = top + down + panel[1] + _MARGIN_PX
    page = Image.new("RGB", (width, rule + footer[1] + _MARGIN_PX), UNKNOWN)
    return page, [(left, top), (left + across, top + down)], rule


def _paint_headed(page: Image.Image, panel: Image.Image, place: tuple[int, int], head: str, px_per_m: float) -> None:
    """Paint a panel, above it at the left what it shows and at the right its scale."""
    draw, (left, top) = ImageDraw.Draw(page), place
    page.paste(panel, place)
    draw.text((left, top - 16 * _UNIT), head, fill=OCCUPIED, font=font(TEXT_SIZE, _UNIT), anchor="ls")
    paint_scale(draw, left + panel.width, top - round(_HEAD * _UNIT), px_per_m, _UNIT)
