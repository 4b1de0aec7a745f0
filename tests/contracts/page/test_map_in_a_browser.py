"""A map that grows, in a real browser: watched, moved by hands, and seen by several."""

import threading

import numpy as np
import pytest

from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from support.browsing import (
    PATIENCE_S,
    Mapping,
    click,
    colours,
    on_screen,
    pixels_of,
    pressed,
    text,
    told,
    view,
    wait,
    wait_for_all,
)


def test_the_map_grows_and_is_finished(browser, drive, screenshot):
    with LivePage("loop.clf", LiveOptions(port=0, speed=4.0), range_max_m=30.0) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("stage") == "waiting", "the page is connected")
        mapping = Mapping(page, drive)
        first = int(wait(lambda: told(browser).get("tiles") not in (None, "0") and told(browser)["tiles"], "tiles"))
        wait(lambda: int(told(browser)["tiles"]) > first + 10, "the map grows")
        assert colours(browser) > 5
        wait(lambda: colours(browser, "#n_eff") > 2 and colours(browser, "#latency") > 2, "both charts are drawn")
        wait(lambda: pixels_of(browser, "scan") > 20, "the scan is seen")
        wait(lambda: pixels_of(browser, "path") > 20, "the way is seen")
        screenshot("running")
        wait(lambda: told(browser)["stage"] == "final refinement", "the last scan")
        assert "loop closure" in text(browser, "#summary")
        wait(lambda: pixels_of(browser, "closure") > 5, "the loop closure is seen")
        screenshot("closed")
        mapping.join(PATIENCE_S)
        grid = mapping.state.maps.occupancy(mapping.state.best)
        page.finish(grid, mapping.state.ancestry.trajectory(mapping.state.best), np.zeros((0, 4)))
        wait(lambda: told(browser)["stage"] == "writing", "it is not written yet")
        threading.Thread(target=page.serve_until_left, daemon=True).start()
        wait(lambda: told(browser)["stage"] == "finished", "done")
        screenshot("done")


def test_hands_move_the_map(browser, drive):
    from selenium.webdriver import ActionChains

    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.get(page.url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait_for_all(browser)
        assert pressed(browser, "fit"), "all of the map is shown at first"
        whole = before = view(browser)
        ActionChains(browser).drag_and_drop_by_offset(browser.find_element("id", "map"), 60, 40).perform()
        wait(lambda: not pressed(browser, "fit"), "a drag leaves the whole map")
        wait(lambda: view(browser)[0] < before[0], "and moves it")
        assert (view(browser) - before)[:2] * before[2] == pytest.approx([-60, 40], abs=1.0)
        before, rule = view(browser), text(browser, "#scale")
        browser.execute_script(
            "document.querySelector('#map').dispatchEvent("
            "new WheelEvent('wheel', {deltaY: -1500, clientX: 500, clientY: 400, cancelable: true}))"
        )
        wait(lambda: text(browser, "#scale") != rule, "the wheel zooms")
        after = view(browser)
        assert after[2] == pytest.approx(before[2] * np.exp(0.0016 * 1500), rel=0.01)
        for here in (before, after):  # what is under the pointer stays
            x, y = here[0] + (500 - here[3]) / here[2], here[1] - (400 - here[4]) / here[2]
            assert on_screen(browser, x, y) == pytest.approx((500, 400), abs=1.0)
        click(browser, "follow")
        wait(lambda: pressed(browser, "follow"), "the robot is followed")
        pose = page._run.make_scene().status["pose"]
        wait(lambda: np.hypot(*(view(browser)[:2] - pose[:2])) < 0.05, "the robot is in the middle")
        click(browser, "fit")
        wait(lambda: view(browser)[2] == pytest.approx(whole[2], rel=0.01), "all of the map is shown again")
        drawn = colours(browser)
        for layer in browser.find_elements("css selector", "#layers label:not([hidden])"):
            layer.click()
        wait(lambda: colours(browser) < drawn / 2, "nothing but the robot is shown")
