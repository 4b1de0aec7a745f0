"""A phone in the dark, 375 x 667, under fingers."""

import numpy as np
import pytest

from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from support.browsing import (
    PATIENCE_S,
    Mapping,
    click,
    move_fingers,
    on_screen,
    pressed,
    shown,
    told,
    view,
    wait,
    wait_for_all,
)


def apart(first, second):
    """Whether two boxes on the screen do not overlap."""
    return any(
        one[low] + one[size] <= other[low]
        for low, size in (("x", "width"), ("y", "height"))
        for one, other in ((first, second), (second, first))
    )


def controls(phone):
    """The boxes of the controls at the foot, none of which overlaps another or is cut off."""
    parts = phone.find_elements("css selector", "#transport > :not([hidden])")
    boxes = [part.rect for part in parts if part.is_displayed()]
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= 375 for box in boxes)
    assert all(apart(one, other) for k, one in enumerate(boxes) for other in boxes[:k])
    return boxes


def test_nothing_overlaps_or_is_cut_off(phone, drive, screenshot):
    title = "a drive with a rather long name that does not fit on a phone.clf"
    with LivePage(title, LiveOptions(port=0), range_max_m=30.0) as page:
        phone.get(page.url)
        wait(lambda: told(phone).get("stage") == "waiting", "the page is connected")
        Mapping(page, drive).join(PATIENCE_S)
        wait_for_all(phone)
        assert int(told(phone)["tiles"]) > 50
        assert not shown(phone, "panel")
        screenshot("map")
        for opened in (False, True):
            if opened:
                click(phone, "sheet")
                assert shown(phone, "panel")
                screenshot("details")
            assert not phone.execute_script("return document.documentElement.scrollWidth > innerWidth")
            names = ["bar", "transport"] + (["panel"] if opened else ["scale"])
            boxes = [phone.find_element("id", name).rect for name in names]
            assert all(apart(one, other) for k, one in enumerate(boxes) for other in boxes[:k])
            assert len(controls(phone)) == 4, "a running filter is not played"
        click(phone, "sheet")


def test_fingers_move_and_stretch_the_map_and_choose_a_particle(phone, drive, screenshot):
    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        phone.get(page.url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait_for_all(phone)
        assert pressed(phone, "fit"), "all of the map is shown at first"
        before = view(phone)
        move_fingers(phone, [(150, 300)], [(210, 340)])
        wait(lambda: not pressed(phone, "fit"), "a finger moves the map")
        assert (view(phone) - before)[:2] * before[2] == pytest.approx([-60, 40], abs=10)  # the first px may be lost
        before = view(phone)
        middle = before[0] + (180 - before[3]) / before[2], before[1] - (300 - before[4]) / before[2]
        move_fingers(phone, [(160, 300), (200, 300)], [(120, 300), (240, 300)])
        wait(lambda: view(phone)[2] > before[2], "two fingers stretch it")
        assert view(phone)[2] == pytest.approx(3 * before[2], rel=0.05)
        assert on_screen(phone, *middle) == pytest.approx((180, 300), abs=5)
        click(phone, "follow")
        pose = page._run.make_scene().frame.particles[0]
        wait(lambda: np.hypot(*(view(phone)[:2] - pose[:2])) < 0.2, "the robot is followed")
        move_fingers(phone, [(160, 300), (200, 300)], [(60, 300), (300, 300)])
        screenshot("near")
