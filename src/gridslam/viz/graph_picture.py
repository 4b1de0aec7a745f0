"""Picture of a pose graph before and after optimization."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from gridslam.errors import ArgumentError
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray
from gridslam.viz.canvas import (
    CLOSURE,
    FREE,
    MARGIN,
    OCCUPIED,
    REJECTED,
    TEXT_SIZE,
    UNKNOWN,
    Colour,
    dots,
    fit_page,
    font,
    mark_ends,
    paint_footer,
    paint_scale,
    stroke,
    time_colours,
)

_UNIT = 1.5  # factor on all sizes of text and lines, for a page of some 2200 px
_PAD_PX = 36
_HEAD_PX = 90
_GAP_PX = round(MARGIN * _UNIT)  # between the panels
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
    width, height = (np.ceil(box).astype(int) + 2 * _PAD_PX).tolist()
    across = width + _GAP_PX
    down = 0
    if width > _WIDE * height:
        across = 0
        down = height + _HEAD_PX + _GAP_PX
    size, (left, top, _, bottom) = fit_page(width + across, height + _HEAD_PX + down, _UNIT, title, caption)
    page = Image.new("RGB", size, UNKNOWN)
    draw = ImageDraw.Draw(page)
    states = zip((before, graph.poses), heads, scales, ((left, top), (left + across, top + down)), strict=True)
    for poses, head, px_per_m, (x, y) in states:
        draw.text((x, y + _HEAD_PX - 16 * _UNIT), head, fill=OCCUPIED, font=font(TEXT_SIZE, _UNIT), anchor="ls")
        paint_scale(draw, x + width, y, px_per_m, _UNIT)
        page.paste(_panel(graph, poses, rejected, (width, height), px_per_m), (x, y + _HEAD_PX))
    keys: list[tuple[str, Colour]] = [("loop closures", CLOSURE)]
    if rejected is not None:
        keys.append(("rejected", REJECTED))
    paint_footer(page, bottom, _UNIT, title, caption, keys, ends)
    return page


def _fit(both: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, list[float]]:
    """Width and height of a panel's drawing in px, and the scale of each panel in px/m."""
    spans = np.array([np.ptp(poses[:, :2], axis=0) for poses in both])
    spans = np.maximum(spans, _SLENDER * np.maximum(spans.max(axis=1, keepdims=True), 1.0))
    longest = spans.max(axis=1)
    if longest.max() <= _ALIKE * longest.min():
        spans[:] = spans.max(axis=0)
    box = spans[1] * _SIDE_PX / spans[1].max()
    return box, (box / spans).min(axis=1).tolist()


def _panel(
    graph: PoseGraph, poses: FloatArray, rejected: NDArray[np.bool_] | None, size: tuple[int, int], px_per_m: float
) -> Image.Image:
    """Draw one state of the graph, in the middle of its panel."""
    panel = Image.new("RGB", size, FREE)
    middle = 0.5 * (poses[:, :2].min(axis=0) + poses[:, :2].max(axis=0))
    at = (poses[:, :2] - middle) * [px_per_m, -px_per_m] + 0.5 * np.array(size)
    lines = at[graph.edges].reshape(-1, 4)
    false = np.zeros(len(lines), np.bool_) if rejected is None else rejected
    colours = time_colours(np.linspace(0.0, 1.0, len(at)))
    odometry = np.flatnonzero(graph.trusted & ~false)
    steps = np.hypot(*(lines[odometry, 2:] - lines[odometry, :2]).T)
    stroke(panel, lines[false], REJECTED, 1.5)
    stroke(panel, lines[~graph.trusted & ~false], CLOSURE, 1.8)
    stroke(panel, lines[odometry], [colours[k] for k in graph.edges[odometry].max(axis=1).tolist()], 2.25)
    # A pose's dot is as large as allows neighbours to be distinguished, within limits.
    dots(panel, at, colours, float(np.clip(0.5 * np.median(steps), 3.0, 7.5)) if len(steps) else 7.5)
    mark_ends(panel, at[[0, -1]], 9.0)
    return panel
