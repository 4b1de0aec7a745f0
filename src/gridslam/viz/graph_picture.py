"""Picture of a pose graph."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gridslam.errors import ArgumentError
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.viz.canvas import (
    CLOSURE,
    REJECTED,
    Colour,
    dots,
    mark_ends,
    open_page,
    paint_footer,
    stroke,
    time_colours,
)


def draw_graph(
    graph: PoseGraph,
    *,
    rejected: NDArray[np.bool_] | None = None,
    title: str = "",
    caption: Sequence[str] = (),
    ends: tuple[str, str] = ("first", "last"),
) -> Image.Image:
    """Draw a graph: poses coloured by their order, odometry and loop closures, a scale bar and a caption.

    Parameters
    ----------
    graph : PoseGraph
        Its trusted edges are drawn as odometry, the others as loop closures.
    rejected : (M,) bool, optional
        Edges that were found to be false, drawn in a colour of their own.
    title, caption : str, sequence of str
        First line of the caption, in larger letters, and further lines.
    ends : (str, str)
        Names of the first and the last pose in the key to the colours.

    Returns
    -------
    PIL.Image.Image
        RGB.

    Raises
    ------
    ArgumentError
        `rejected` has not the shape that fits the graph.
    """
    false = np.zeros(len(graph.edges), np.bool_) if rejected is None else rejected
    if false.shape != graph.trusted.shape:
        raise ArgumentError("rejected", f"shape {graph.trusted.shape}", false.shape)
    page, layout = open_page(graph.poses[:, :2], title, caption)
    u = layout.unit
    at = layout.pixels(graph.poses[:, :2])
    lines = at[graph.edges].reshape(-1, 4)
    colours = time_colours(np.linspace(0.0, 1.0, len(at)))
    odometry = np.flatnonzero(graph.trusted & ~false)
    steps = np.hypot(*(lines[odometry, 2:] - lines[odometry, :2]).T)
    stroke(page, lines[false], REJECTED, u)
    stroke(page, lines[~graph.trusted & ~false], CLOSURE, 1.2 * u)
    stroke(page, lines[odometry], [colours[k] for k in graph.edges[odometry].max(axis=1).tolist()], 1.5 * u)
    # A pose's dot is as large as allows neighbours to be distinguished, within limits.
    size = float(np.clip(0.5 * np.median(steps), 2.0 * u, 5.0 * u)) if len(steps) else 5.0 * u
    dots(page, at, colours, size)
    mark_ends(page, at[[0, -1]], 6.0 * u)
    keys: list[tuple[str, Colour]] = [("loop closures", CLOSURE)]
    if rejected is not None:
        keys.append(("rejected", REJECTED))
    paint_footer(page, layout, title, caption, keys, ends)
    return page
