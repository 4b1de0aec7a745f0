"""The page in a real browser: it sees the map grow, pauses, picks a particle, and outlives a restart of the server.

Needs Chromium, its driver and the package selenium; skipped with the reason where one is missing, and failed where
GRIDSLAM_REQUIRE_BROWSER=1. Screenshots go to the folder GRIDSLAM_SCREENSHOTS, if that is set.
"""

from __future__ import annotations

import json
import os
import shutil
import threading
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from loops import PROVOKED, loop_drive

from gridslam.api import map_log
from gridslam.config import build
from gridslam.io.carmen_writer import write_carmen
from gridslam.live.control import RobotControl
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.live.replay import ReplayPage
from gridslam.pipeline import run

FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync",
    "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
)  # fmt: skip
BROWSERS = "chromium", "chromium-browser", "google-chrome"
PATIENCE_S = 60.0


def missing():
    """What there is not of all that is needed."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "the package selenium"
    programs = {"chromium": BROWSERS, "chromedriver": ("chromedriver",)}
    return next((what for what, names in programs.items() if not any(map(shutil.which, names))), None)


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if lacking := missing():
        reason = f"no browser to test the page with: {lacking} is missing"
        pytest.fail(reason) if os.environ.get("GRIDSLAM_REQUIRE_BROWSER") == "1" else pytest.skip(reason)
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    profile, downloads = tmp_path_factory.mktemp("profile"), tmp_path_factory.mktemp("downloads")
    options = webdriver.ChromeOptions()
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.binary_location = next(filter(None, map(shutil.which, BROWSERS)))
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    driver.set_window_size(1400, 900)
    driver.downloads = downloads
    yield driver
    driver.quit()


@pytest.fixture(autouse=True)
def no_error_in_the_console(browser):
    browser.get_log("browser")
    yield
    # a server that goes away is an error to a browser, and ordinary to the page
    said = [entry["message"] for entry in browser.get_log("browser") if "ERR_CONNECTION" not in entry["message"]]
    assert said == []


@pytest.fixture
def screenshot(browser, request):
    def take(name):
        if folder := os.environ.get("GRIDSLAM_SCREENSHOTS"):
            Path(folder).mkdir(parents=True, exist_ok=True)
            browser.save_screenshot(str(Path(folder) / f"{request.node.name}-{name}.png"))

    return take


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements


def told(browser):
    """What the page knows: numbers and words on its body."""
    return browser.execute_script("return {...document.body.dataset}")


def wait(condition, what):
    until = time.monotonic() + PATIENCE_S
    while not (got := condition()):
        assert time.monotonic() < until, f"it did not happen: {what}"
        time.sleep(0.05)
    return got


def click(browser, name):
    browser.find_element("id", name).click()


def shades(browser):
    """How many colours are on the map canvas."""
    return browser.execute_script(
        "const map = document.querySelector('#map');"
        "const pixels = new Uint32Array(map.getContext('2d').getImageData(0, 0, map.width, map.height).data.buffer);"
        "return new Set(pixels).size;"
    )


class Mapping(threading.Thread):
    """A filter that maps a drive on a page."""

    def __init__(self, page, drive):
        super().__init__(daemon=True)
        self.page, self.drive, self.state = page, drive, None
        self.start()

    def run(self):
        slam, rng = build(PROVOKED), np.random.default_rng(1)
        source, observers = self.page.paced(self.drive), [self.page.observer]
        self.state = run(source, slam, particles=8, rng=rng, observers=observers)


def test_the_map_grows_is_paused_stepped_and_finished(browser, drive, screenshot):
    with LivePage("loop.clf", LiveOptions(port=0, speed=20.0), range_max_m=30.0) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("stage") == "waiting", "the page is connected")
        mapping = Mapping(page, drive)
        first = int(wait(lambda: told(browser).get("tiles") not in (None, "0") and told(browser)["tiles"], "tiles"))
        wait(lambda: int(told(browser)["tiles"]) > first + 10, "the map grows")
        assert shades(browser) > 5
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
        page.control.set_speed(None)
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "last word", "the last scan")
        mapping.join(PATIENCE_S)
        grid = mapping.state.maps.occupancy(mapping.state.best)
        page.finish(grid, mapping.state.ancestry.trajectory(mapping.state.best), np.zeros((0, 4)))
        wait(lambda: told(browser)["stage"] == "done", "done")
        screenshot("done")


def test_a_particle_is_picked_and_its_map_is_seen(browser, drive, screenshot):
    from selenium.webdriver import ActionChains

    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("stage") == "waiting", "the page is connected")
        page.control.step(to_key_scan=True)
        mapping = Mapping(page, drive[:80])
        for _ in range(12):
            keys = wait(lambda: told(browser).get("keys", "0"), "key scans")
            page.control.step(to_key_scan=True)
            wait(lambda keys=keys: told(browser)["keys"] != keys, "a key scan")
        strip = browser.find_element("id", "weights")
        left = -strip.size["width"] / 2 + strip.size["width"] * 2.5 / 8
        ActionChains(browser).move_to_element_with_offset(strip, int(left), 0).click().perform()
        wait(lambda: told(browser)["watched"] == "2", "particle 2 is chosen")
        wait(lambda: int(told(browser)["tiles"]) > 0, "its map")
        assert "map of number 2" in browser.find_element("id", "watched").text
        screenshot("chosen")
        click(browser, "best")
        wait(lambda: told(browser)["watched"] == "", "the best again")
        page.control.resume()
        mapping.join(PATIENCE_S)


def test_a_restart_of_the_server_is_outlived(browser, drive, screenshot):
    with LivePage("before", LiveOptions(port=0), range_max_m=30.0) as page:
        url, port = page.url, int(page.url.rstrip("/").rpartition(":")[2])
        browser.get(url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        session = wait(lambda: told(browser).get("tiles", "0") != "0" and told(browser)["session"], "a map")
    wait(lambda: told(browser)["stage"] == "offline", "the page notices")
    assert "trying again" in browser.find_element("id", "notice").text
    screenshot("offline")
    with LivePage("after", LiveOptions(port=port), range_max_m=30.0) as page:
        wait(lambda: told(browser)["session"] != session, "the page is back")
        assert browser.find_element("id", "title").text == "after"
        assert told(browser)["tiles"] == "0", "the map of the run before is still there"
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait(lambda: int(told(browser)["tiles"]) > 0, "the new map")
        assert not browser.find_element("id", "notice").is_displayed()


def test_a_phone_and_the_dark(browser, drive, screenshot):
    phone = {"width": 390, "height": 800, "deviceScaleFactor": 2, "mobile": True}
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
        try:
            browser.get(page.url)
            Mapping(page, drive).join(PATIENCE_S)
            wait(lambda: int(told(browser).get("tiles", 0)) > 50, "a map")
            assert not browser.find_element("id", "panel").is_displayed()
            screenshot("map")
            click(browser, "sheet")
            assert browser.find_element("id", "panel").is_displayed()
            screenshot("details")
            wide = "return document.documentElement.scrollWidth > innerWidth"
            assert not browser.execute_script(wide)
            for control in browser.find_elements("css selector", "#transport button"):
                box = control.rect
                assert 0 <= box["x"] <= 390 - box["width"]
            click(browser, "sheet")
        finally:
            browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
            browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_hands_move_the_map_and_save_it(browser, drive):
    from selenium.webdriver import ActionChains

    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.get(page.url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait(lambda: told(browser).get("keys", "0") != "0", "a map")

        def pressed(name):
            return browser.find_element("id", name).get_attribute("aria-pressed") == "true"

        wait(lambda: pressed("fit"), "all of the map is shown at first")
        rule = browser.find_element("id", "scale").text
        canvas = browser.find_element("id", "map")
        ActionChains(browser).drag_and_drop_by_offset(canvas, 60, 40).perform()
        wait(lambda: not pressed("fit"), "a drag leaves the whole map")
        ActionChains(browser).scroll_by_amount(0, -2000).perform()
        browser.execute_script(
            "document.querySelector('#map').dispatchEvent("
            "new WheelEvent('wheel', {deltaY: -1500, clientX: 500, clientY: 400, cancelable: true}))"
        )
        wait(lambda: browser.find_element("id", "scale").text != rule, "the wheel zooms")
        click(browser, "follow")
        wait(lambda: pressed("follow"), "the robot is followed")
        click(browser, "fit")
        click(browser, "save-map")
        archive = wait(lambda: next(browser.downloads.glob("*.zip"), None), "the map is saved")
        wait(lambda: zipfile.is_zipfile(archive), "all of it")
        assert sorted(zipfile.ZipFile(archive).namelist()) == ["map.pgm", "map.yaml"]
        click(browser, "save-picture")
        wait(lambda: next(browser.downloads.glob("*.png"), None), "the picture is saved")


def test_a_robot_is_paused_but_not_held_and_what_is_wrong_is_read(browser, drive, screenshot):
    paused = []
    control = RobotControl(lambda: bool(paused) and paused[-1], paused.append)
    with LivePage("ROS 1", LiveOptions(port=0), range_max_m=30.0, robot=control) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("stage") == "waiting", "the page is connected")

        def shown(name):
            return browser.find_element("id", name).is_displayed()

        def mapped(part):
            rng, observers = np.random.default_rng(1), [page.observer]
            run(page.session(part), build(PROVOKED), particles=8, rng=rng, observers=observers)
            page.say("")

        page.say("missing transform: base_link <- laser")
        wait(lambda: shown("notice"), "what is wrong")
        assert browser.find_element("id", "notice").text == "missing transform: base_link <- laser"
        mapped(drive[:60])
        session = wait(lambda: int(told(browser)["tiles"]) > 10 and told(browser)["session"], "a map")
        wait(lambda: not shown("notice"), "nothing is wrong any more")
        assert [name for name in ("pause", "step", "speed", "line", "follow") if shown(name)] == ["pause", "follow"]
        browser.find_element("tag name", "body").send_keys(".")  # the key for a step does nothing
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "paused", "paused")
        screenshot("paused")
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "running", "it goes on")
        assert paused == [True, False]
        mapped(drive[60:64])
        wait(lambda: told(browser)["session"] != session, "another session")
        wait(lambda: int(told(browser)["tiles"]) > 0, "its map")
        assert int(told(browser)["keys"]) < 5


def test_a_finished_run_has_a_time_line(browser, drive, tmp_path, screenshot):
    write_carmen(tmp_path / "loop.clf.gz", drive[:200])
    map_log(tmp_path / "loop.clf.gz", configuration=PROVOKED, repair="none").save(tmp_path / "out")
    with ReplayPage(tmp_path / "out", LiveOptions(port=0)) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("tiles", "0") != "0", "the map")
        line = browser.find_element("id", "line")
        last = int(line.get_attribute("max"))
        assert int(line.get_attribute("value")) == last

        def time_of():
            return browser.find_element("css selector", "#time output").text

        end = time_of()
        browser.execute_script("arguments[0].value = 20; arguments[0].dispatchEvent(new Event('input'))", line)
        wait(lambda: time_of() != end and int(line.get_attribute("value")) == 20, "the time line")
        screenshot("early")
        click(browser, "pause")
        wait(lambda: int(line.get_attribute("value")) > 25, "it plays")
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "paused", "it pauses")
        record = json.loads((tmp_path / "out" / "run.json").read_text())["scans"]["used"]
        assert last == record - 1
        screenshot("later")
