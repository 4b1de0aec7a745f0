"""The picture of a graph shows what it was and what it is, to scale."""

import numpy as np

from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.viz import draw_graph
from gridslam.viz.canvas import CLOSURE, FREE, REJECTED, TIME_ENDS, time_colours


def _square(closures=((0, 3),), side_m=10.0):
    """Four poses around a square, then the closures."""
    poses = np.array([[0, 0, 0], [side_m, 0, 1.57], [side_m, side_m, 3.14], [0, side_m, -1.57]])
    edges = [(0, 1), (1, 2), (2, 3), *closures]
    return PoseGraph.of(poses, edges, np.zeros((len(edges), 3)), [np.eye(3)] * len(edges))


def _panels(page):
    """Left, top, right, bottom of the two panels: what is almost white and large."""
    white = (np.asarray(page) == FREE).all(axis=2)
    rows = np.flatnonzero(white.mean(axis=1) > 0.3)
    columns = np.flatnonzero(white[rows].mean(axis=0) > 0.3)
    across, down = (np.split(k, np.flatnonzero(np.diff(k) > 50) + 1) for k in (columns, rows))
    return [(c[0], r[0], c[-1] + 1, r[-1] + 1) for r in down for c in across]


def _has(page, box, colour, within=0):
    return bool((np.abs(np.asarray(page.crop(box)).astype(np.int16) - colour).max(axis=2) <= within).any())


def test_both_states_are_drawn_and_the_path_has_the_colours_of_its_order():
    graph = _square()
    page = draw_graph(graph, graph.poses * 0.9)
    before, after = _panels(page)
    for box in (before, after):
        assert _has(page, box, CLOSURE)
        assert _has(page, box, TIME_ENDS[1])
        assert not _has(page, box, REJECTED)
        for share in (1 / 3, 2 / 3):  # the dots of the poses between the ends
            assert _has(page, box, time_colours(np.array([share]))[0])


def test_poses_that_are_all_in_one_place_before():
    graph = _square()
    page = draw_graph(graph, np.zeros((4, 3)))
    assert _has(page, _panels(page)[1], CLOSURE)
