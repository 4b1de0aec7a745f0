"""Charts: what is drawn, where, and that any values can be."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.viz.canvas import CLOSURE, FREE, OCCUPIED, TIME_ENDS
from gridslam.viz.chart import draw_chart

LEFT, TOP, RIGHT, BOTTOM = 130, 90, 1350, 710


def chart(*series, marks=()):
    drawn = tuple(
        SimpleNamespace(name=f"s{k}", x=np.array(x, float), y=np.array(y, float), style=style)
        for k, (x, y, style) in enumerate(series)
    )
    return SimpleNamespace(title="T", x_label="x, m", y_label="y, m", series=drawn, marks=marks)


def where(page, colour):
    """Rows and columns within the axes of what has a colour."""
    rows, columns = np.nonzero((np.asarray(page)[TOP:BOTTOM, LEFT:RIGHT] == colour).all(axis=2))
    return rows, columns


def test_dots_lie_where_the_axes_say():
    page = draw_chart(chart(([0.0, 10.0], [0.0, 5.0], "dots")))
    rows, columns = where(page, OCCUPIED)
    # 4 % of room on both sides of x and above y
    width, height = RIGHT - LEFT, BOTTOM - TOP
    assert columns.min() == pytest.approx(0.04 / 1.08 * width, abs=4)
    assert columns.max() == pytest.approx(1.04 / 1.08 * width, abs=4)
    assert rows.min() == pytest.approx(0.04 / 1.04 * height, abs=4)


def test_bars_stand_on_zero():
    page = draw_chart(chart(([1, 2, 3], [2.0, 4.0, 1.0], "bars")))
    rows, columns = where(page, OCCUPIED)
    heights = [BOTTOM - TOP - rows[columns == column].min() for column in np.unique(columns)]
    assert max(heights) == pytest.approx((BOTTOM - TOP) / 1.04, abs=3)
    assert min(heights) == pytest.approx(0.25 * max(heights), abs=3)


def test_series_have_colours_of_their_own_and_marks_one():
    mark = SimpleNamespace(name="limit", value=0.5, axis="y")
    page = draw_chart(chart(([0, 1], [0, 1], "line"), ([0, 1], [1, 0], "line"), marks=(mark,)))
    for colour in (OCCUPIED, CLOSURE, TIME_ENDS[1]):
        assert len(where(page, colour)[0]) > 100
    assert len(np.unique(where(page, TIME_ENDS[1])[0])) <= 4, "it is level"


def test_a_caption_is_wrapped_and_makes_the_page_longer():
    without, with_ = (draw_chart(chart(([0, 1], [0, 1], "line")), caption=c) for c in ((), ["many words " * 40]))
    assert with_.width == without.width == 1400
    assert with_.height > without.height + 100
    assert np.asarray(with_)[-200:, -40:].min() > 200, "nothing reaches the margin"


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.floats(-1e12, 1e12) | st.just(math.nan) | st.just(math.inf), max_size=20),
    st.sampled_from(["line", "dots", "bars"]),
)
def test_any_values_can_be_drawn(values, style):
    page = draw_chart(chart((np.arange(len(values)), values, style)))
    assert page.getpixel((LEFT + 5, TOP + 5)) is not None
    assert (np.asarray(page)[:60] != FREE).any()
