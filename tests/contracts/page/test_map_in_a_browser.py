"""A map that grows, in a real browser: paused, stepped, moved by hands, saved, and seen by several."""

import threading
import time

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


def test_the_map_grows_is_paused_stepped_and_finished(browser, drive, screenshot):
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
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "paused", "paused")
        time.sleep(0.5)  # the scan that is being mapped comes yet
        keys = told(browser)["keys"]
        time.sleep(0.5)
        assert told(browser)["keys"] == keys
        click(browser, "step")
        wait(lambda: int(told(browser)["keys"]) == int(keys) + 1, "one key scan more")
        assert told(browser)["stage"] == "paused"
        screenshot("paused")
        speed = browser.find_element("id", "speed")
        speed.find_element("css selector", "option[value='2']").click()
        wait(lambda: page.control.speed == 2.0, "the page sets the speed")
        speed.find_element("css selector", "option[value='']").click()
        wait(lambda: page.control.speed is None, "as fast as can be")
        click(browser, "pause")
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


def test_a_particle_is_picked_and_its_map_is_seen(browser, drive, screenshot):

    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("stage") == "waiting", "the page is connected")
        page.control.step(to_key_scan=True)
        mapping = Mapping(page, drive[:80])
        for _ in range(12):
            keys = wait(lambda: told(browser).get("keys", "0"), "key scans")
            page.control.step(to_key_scan=True)
            wait(lambda keys=keys: told(browser)["keys"] != keys, "a key scan")
        for _ in range(7):
            browser.find_element("tag name", "body").send_keys("+")
        click(browser, "follow")
        time.sleep(1.0)  # the camera gets there
        screenshot("near")
        page.control.resume()
        mapping.join(PATIENCE_S)


def test_hands_move_the_map(browser, drive):
    from selenium.webdriver import ActionChains

    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.get(page.url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait_for_all(browser)
        assert pressed(browser, "fit"), "all of the map is shown at first"
        before = view(browser)
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
        drawn = colours(browser)
        for layer in browser.find_elements("css selector", "#layers label:not([hidden])"):
            layer.click()
        wait(lambda: colours(browser) < drawn / 2, "nothing but the robot is shown")


def test_several_look_at_one_run_each_as_it_likes(browser, drive):
    """One pauses, and all see it; one looks back, and the others do not."""
    from selenium.webdriver import ActionChains, Keys

    with LivePage("loop.clf", LiveOptions(port=0, speed=5.0), range_max_m=30.0) as page:
        browser.get(page.url)
        first = browser.current_window_handle
        mapping = Mapping(page, drive)
        wait(lambda: int(told(browser).get("keys", "0")) > 3, "key scans")
        browser.switch_to.new_window("tab")
        browser.get(page.url)
        wait(lambda: int(told(browser).get("keys", "0")) > 3, "all that was before")
        wait(lambda: page.viewers == 2, "two look")
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "paused", "paused")
        ActionChains(browser).send_keys(Keys.HOME).perform()
        wait(lambda: told(browser)["at"] == "0", "one looks at the beginning")
        second = browser.current_window_handle
        browser.switch_to.window(first)
        wait(lambda: told(browser)["stage"] == "paused", "paused for the other, too")
        assert told(browser)["at"] == ""
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "running", "anyone ends a pause")
        browser.switch_to.window(second)
        browser.close()
        browser.switch_to.window(first)
        wait(lambda: page.viewers == 1, "one has gone")
        page.control.end()
        mapping.join(PATIENCE_S)


def test_the_past_of_a_running_filter(browser, drive, screenshot):
    """The time line goes back, and to the present again."""
    from selenium.webdriver import ActionChains, Keys

    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.get(page.url)
        Mapping(page, drive[:150]).join(PATIENCE_S)
        wait_for_all(browser)
        tiles = int(told(browser)["tiles"])
        keys = int(told(browser)["keys"])
        ActionChains(browser).send_keys(Keys.HOME).perform()
        wait(lambda: told(browser)["at"] == "0", "the beginning")
        wait(lambda: int(told(browser)["tiles"]) < tiles, "the map was smaller")
        assert "as it was" in text(browser, "#stage")
        screenshot("beginning")
        ActionChains(browser).send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT).perform()
        wait(lambda: told(browser)["at"] == "2", "two key scans on")
        browser.find_element("id", "n_eff").click()
        wait(lambda: 0.2 * keys < int(told(browser)["at"] or 0) < 0.8 * keys, "where the chart was clicked")
        screenshot("middle")
        ActionChains(browser).send_keys(Keys.END).perform()
        wait(lambda: told(browser)["at"] == "", "the present")
        wait(lambda: int(told(browser)["tiles"]) == tiles, "all of the map")
