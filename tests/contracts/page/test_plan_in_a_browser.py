"""A browser shows the SVG of a floor plan as large as it is, and in it what the plan has."""

import numpy as np
import pytest

from gridslam.plan import make_plan
from gridslam.plan.exports import write_svg
from support.drawn_maps import draw_two_rooms

PX_PER_MM = 96 / 25.4
MEASURE = """
const of = selector => [...document.querySelectorAll(selector)];
const root = document.documentElement;
return {
  size: [root.getBoundingClientRect().width, root.getBoundingClientRect().height],
  stated: [root.viewBox.baseVal.width, root.viewBox.baseVal.height],
  room: of("polygon.rooms").map(each => [each.getBBox().width, each.getBBox().height]),
  walls: of(".walls, .faces").length, doors: of("text.doors").map(each => each.textContent),
  errors: of("parsererror").length,
};
"""


def test_the_svg_is_shown_to_scale(browser, tmp_path, screenshot):
    plan = make_plan(draw_two_rooms())
    write_svg(tmp_path / "plan.svg", plan, "two <rooms>", 50)
    browser.get((tmp_path / "plan.svg").as_uri())
    seen = browser.execute_script(MEASURE)
    screenshot("plan")
    assert seen["errors"] == 0
    assert seen["size"] == pytest.approx([side * PX_PER_MM for side in seen["stated"]], rel=0.01)
    for box, room in zip(seen["room"], plan.rooms, strict=True):
        assert box == pytest.approx((np.ptp(room.outline, axis=0) * 20).tolist(), abs=0.05)  # mm, at 1:50
    assert seen["walls"] == len(plan.walls)
    assert seen["doors"] == [f"{opening.width_m:.2f}" for opening in plan.openings]
