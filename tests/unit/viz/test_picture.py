"""The picture shows the right colours in the right places, at a size fit for people."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import ImageDraw

from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import OccupancyGrid, Trajectory
from gridslam.viz import draw_graph, draw_map
from gridslam.viz.canvas import (
    CLOSURE,
    FREE,
    LOST,
    MARGIN,
    OCCUPIED,
    REJECTED,
    TIME_ENDS,
    TRUTH,
    UNKNOWN,
    time_colours,
)
from gridslam.viz.cloud import select_representatives
from gridslam.viz.picture import SIGMAS, draw_landmarks, draw_localization, ellipse, lay_out
from support.localization_world import drive, flat_map

RESOLUTION = 0.05


def _grid(shape, known=True, log_odds=-2.0, origin=(0.0, 0.0)):
    return OccupancyGrid(np.full(shape, log_odds, np.float32), np.full(shape, known), RESOLUTION, origin)


def _straight(start, end, count=101):
    poses = np.zeros((count, 3))
    poses[:, :2] = np.linspace(start, end, count)
    return Trajectory(np.arange(count, dtype=np.int64) * 10**9, poses)


def _colour_at(page, layout, x, y):
    column, row = layout.pixels(np.array([[x, y]]))[0]
    return page.getpixel((int(column), int(row)))


@pytest.mark.parametrize(
    "shape", [(60, 80), (700, 700), (90, 1299), (1301, 40), (2000, 1500), (200, 5000), (5000, 300)]
)
def test_page_is_large_enough_to_see_and_small_enough_to_send(shape):
    page = draw_map(_grid(shape), title="a log", caption=["one line", "another", "a third"])
    assert page.mode == "RGB"
    assert 1400 <= max(page.size) <= 4000
    assert page.size[0] * page.size[1] < 16e6


def test_cells_have_their_colours_and_y_points_up():
    grid = _grid((40, 60), origin=(-1.0, 2.0))
    grid.log_odds[30:34, 10:14] = 4.0  # occupied, in the upper left part
    grid.known[4:10, 40:50] = False  # unknown, in the lower right part
    page, layout = draw_map(grid), lay_out(grid)
    assert _colour_at(page, layout, -1.0 + 12 * RESOLUTION, 2.0 + 32 * RESOLUTION) == OCCUPIED
    assert _colour_at(page, layout, -1.0 + 45 * RESOLUTION, 2.0 + 7 * RESOLUTION) == UNKNOWN
    assert _colour_at(page, layout, -1.0 + 12 * RESOLUTION, 2.0 + 7 * RESOLUTION) == FREE
    x, y = layout.pixels(np.array([[-1.0 + 12 * RESOLUTION, 2.0 + 32 * RESOLUTION]]))[0]
    left, top, right, bottom = layout.map_box
    assert x < (left + right) / 2
    assert y < (top + bottom) / 2


@pytest.mark.parametrize(
    ("grid", "shown"),
    [
        (_grid((0, 0)), UNKNOWN),
        (_grid((20, 30), known=False), UNKNOWN),
        (_grid((1, 1)), FREE),
        (_grid((1, 1), log_odds=5.0), OCCUPIED),
    ],
    ids=["no cell", "nothing known", "one free cell", "one occupied cell"],
)
def test_grids_with_next_to_nothing_in_them(grid, shown):
    page, layout = draw_map(grid, _straight((0, 0), (0, 0), 0), title="t"), lay_out(grid, "t")
    left, top, right, bottom = layout.map_box
    assert page.getpixel(((left + right) // 2, (top + bottom) // 2)) == shown
    draw_map(grid, _straight((0, 0), (0, 0), 1), truth=_straight((0, 0), (0, 0), 1), walls=np.empty((0, 4)))


def test_trajectory_has_the_colours_of_time_and_marks_at_its_ends():
    grid = _grid((100, 100))
    page, layout = draw_map(grid, _straight((1.0, 1.0), (4.0, 4.0))), lay_out(grid)
    assert _colour_at(page, layout, 1.0, 1.0) == FREE
    assert _colour_at(page, layout, 4.0, 4.0) == TIME_ENDS[1]
    for share in (0.25, 0.5, 0.75):
        seen = _colour_at(page, layout, 1 + 3 * share, 1 + 3 * share)
        assert seen == pytest.approx(time_colours(np.array([share]))[0], abs=3)
    assert _colour_at(page, layout, 1.0, 4.0) == FREE


@pytest.mark.parametrize("shape", [(60, 80), (300, 420), (700, 700), (1500, 3000)])
def test_scale_bar_is_as_long_as_its_label_says(shape, monkeypatch):
    texts = []
    write = ImageDraw.ImageDraw.text

    def recording(self, xy, text, **options):
        texts.append(text)
        write(self, xy, text, **options)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", recording)
    grid = _grid(shape)
    page, layout = draw_map(grid), lay_out(grid)
    margin = round(MARGIN * layout.unit)
    top_edge = np.asarray(page)[layout.map_box[3] + margin + margin // 2]
    length_px = (top_edge == OCCUPIED).all(axis=1).sum()
    (number, unit), zero = texts[1].split(), texts[0]
    assert zero == "0"
    length_m = float(number) * {"m": 1.0, "cm": 0.01}[unit]
    assert length_px == pytest.approx(length_m * layout.px_per_m, abs=0.5)


def test_keys_of_long_names_leave_the_caption_free():
    drives = {f"{day}_2026-03-02_corridor": _straight((1, k), (9, k)) for k, day in enumerate("abcdefg", 1)}
    grid, caption = _grid((200, 200)), ["a" * 60, "b", "c", "d"]
    top = lay_out(grid, "", caption).map_box[3] + 60
    page = np.asarray(draw_map(grid, drives, caption=caption))[top:]
    first = (page == (213, 94, 0)).all(axis=2).any(axis=0)  # the sample of the first drive's colour
    assert first[600:].any()
    coloured = (np.ptp(page.astype(np.int16), axis=2) > 60).any(axis=0)
    assert not coloured[:600].any(), "there is the caption"
    title = " + ".join(drives)
    sizes = {draw_map(_grid((700, 700)), title=text, caption=["a"]).size for text in (title, 5 * title)}
    assert len(sizes) == 1, "a long title is cut"


@given(st.integers(1, 300), st.integers(1, 100), st.integers(0, 2**32 - 1), st.floats(0.0, 8.0))
def test_any_part_of_a_cloud_keeps_its_weight(count, most, seed, spread):
    """Of a run of particles one after the other the share is told to within 1 / `most`."""
    rng = np.random.default_rng(seed)
    weights = np.exp(spread * rng.normal(size=count))
    weights /= weights.sum()
    chosen, shares = select_representatives(weights, most)
    assert len(chosen) <= min(most, count)
    assert (np.diff(chosen) > 0).all()
    told = np.zeros(count)
    told[chosen] = shares
    assert abs(told.sum() - 1) < 1e-9
    apart = np.cumsum(told) - np.cumsum(weights)
    assert apart.max() - apart.min() <= 1 / most + 1e-9


def test_few_particles_are_all_shown_as_they_are():
    weights = np.array([0.9, 0.1, 0.0])
    chosen, shares = select_representatives(weights, 3)
    np.testing.assert_array_equal(chosen, [0, 1, 2])
    np.testing.assert_array_equal(shares, weights)
    assert len(select_representatives(np.zeros(0))[0]) == 0


def _square(closures=((0, 3),), side_m=10.0):
    """Four poses around a square, then the closures."""
    poses = np.array([[0, 0, 0], [side_m, 0, 1.57], [side_m, side_m, 3.14], [0, side_m, -1.57]])
    edges = [(0, 1), (1, 2), (2, 3), *closures]
    return PoseGraph.of(poses, edges, np.zeros((len(edges), 3)), [np.eye(3)] * len(edges))


def _has(page, colour):
    return bool((np.asarray(page) == colour).all(axis=2).any())


def test_a_graph_has_its_closures_and_the_colours_of_its_order():
    graph = _square()
    page = draw_graph(graph)
    assert _has(page, CLOSURE)
    assert _has(page, TIME_ENDS[1])
    assert not _has(page, REJECTED)
    for share in (1 / 3, 2 / 3):  # the dots of the poses between the ends
        assert _has(page, time_colours(np.array([share]))[0])
    assert _has(draw_graph(graph, rejected=~graph.trusted), REJECTED)
    draw_graph(_square(side_m=0.0))


def test_an_ellipse_has_its_distance_from_the_centre_everywhere():
    rng = np.random.default_rng(0)
    roots, centres = rng.normal(size=(5, 2, 2)), rng.normal(0, 9, (5, 2))
    covariances = roots @ roots.swapaxes(1, 2)
    offsets = ellipse(centres, covariances) - centres[:, None]
    distances = np.einsum("mki,mij,mkj->mk", offsets, np.linalg.inv(covariances), offsets)
    np.testing.assert_allclose(distances, SIGMAS**2, rtol=1e-8)
    np.testing.assert_allclose(offsets[:, 0], offsets[:, -1], atol=1e-12)
    singular = ellipse(centres[:1], np.zeros((1, 2, 2)))
    np.testing.assert_array_equal(singular[0], np.tile(centres[0], (49, 1)))


def _count(page, colour):
    return int((np.asarray(page) == colour).all(axis=2).sum())


def test_more_uncertain_landmarks_take_more_ink_and_truth_is_shown_where_there_is_any():
    angle = np.linspace(0, 6, 100)
    trajectory = Trajectory(np.arange(100) * 10**9, np.stack([angle, np.sin(angle), angle * 0], axis=1))
    positions = np.array([[1.0, 2.0], [4.0, -2.0]])
    small, large = (
        draw_landmarks(trajectory, positions, np.tile(spread * np.eye(2), (2, 1, 1)), title="a", caption=["b"])
        for spread in (1e-4, 0.02)
    )
    assert _count(large, CLOSURE) > _count(small, CLOSURE) > 0
    assert _count(large, TRUTH) == 0
    told = draw_landmarks(
        trajectory, positions, np.tile(0.02 * np.eye(2), (2, 1, 1)), truth=trajectory, true_positions=positions + 0.5
    )
    assert _count(told, TRUTH) > 100
    assert min(told.size) > 800


def painted(page, colour):
    return int((np.asarray(page) == colour).all(axis=2).sum())


def test_where_it_was_lost_and_found():
    grid, truth = flat_map(), drive(1).truth
    lost = np.zeros(len(truth), bool)
    clean = draw_localization(grid, truth, lost, title="flat", caption=["one", "two"])
    assert painted(clean, LOST) == 0
    lost[:30] = True
    page = draw_localization(grid, truth, lost, title="flat", caption=["one", "two"])
    assert page.size == clean.size
    assert painted(page, LOST) > 200
    assert painted(page, CLOSURE) > 50
    everywhere = draw_localization(grid, truth, np.ones(len(truth), bool))
    assert painted(everywhere, LOST) > painted(page, LOST)


def test_poses_off_the_map_and_jumps():
    grid, truth = flat_map(), drive(1).truth
    poses = truth.poses.copy()
    poses[50:60, :2] += 500.0
    page = draw_localization(grid, Trajectory(truth.stamps_ns, poses), np.zeros(len(poses), bool))
    assert max(page.size) >= 1400
