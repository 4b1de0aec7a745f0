"""The picture shows the right colours in the right places, at a size fit for people."""

import numpy as np
import pytest
from PIL import ImageDraw

from gridslam.types import OccupancyGrid, Trajectory
from gridslam.viz import draw_map
from gridslam.viz.canvas import (
    FREE,
    MARGIN,
    OCCUPIED,
    TEXT_SIZE,
    TIME_ENDS,
    UNKNOWN,
    arrange_keys,
    font,
    time_colours,
)
from gridslam.viz.picture import lay_out

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
    names = [f"{day}_2026-03-02_corridor_and_laboratory" for day in ("monday", "tuesday", "wednesday")]
    keys = [(name, (0, 0, 0)) for name in names]

    def length(shown):
        return sum(font(TEXT_SIZE, 1.0).getlength(name) + 70 for name, _ in shown)

    assert arrange_keys(keys, 5000.0, 3, 1.0) == [keys]
    assert arrange_keys(keys, 700.0, 3, 1.0) == [[key] for key in keys], "rows, before names are cut"
    (cut,) = arrange_keys(keys, 700.0, 1, 1.0)
    assert length(cut) <= 700.0
    assert [name[:4] for name, _ in cut] == ["mond", "tues", "wedn"]
    assert length(arrange_keys(keys, 200.0, 1, 1.0)[0]) <= 200.0
    title = " + ".join(names)
    sizes = {draw_map(_grid((700, 700)), title=text, caption=["a"]).size for text in (title, 5 * title)}
    assert len(sizes) == 1, "a long title is cut"
