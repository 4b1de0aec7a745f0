"""Charts: what is drawn, where, and that any values can be."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.viz.canvas import FREE, OCCUPIED
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


@settings(max_examples=15, deadline=None)
@given(
    st.lists(st.floats(-1e12, 1e12) | st.just(math.nan) | st.just(math.inf), max_size=20),
    st.sampled_from(["line", "dots", "bars"]),
)
def test_any_values_can_be_drawn(values, style):
    page = draw_chart(chart((np.arange(len(values)), values, style)))
    assert page.getpixel((LEFT + 5, TOP + 5)) is not None
    assert (np.asarray(page)[:60] != FREE).any()
