"""A known map in a real browser: the cloud converges in it; and what other commands left is seen again."""

import json
import threading

import pytest

from gridslam.api.localization import localize
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.maps import write_map
from gridslam.io.trajectories import write_tum
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.live.replay import Replay
from gridslam.live.server import PageServer
from gridslam.sim import OdometryNoise
from support.browsing import PATIENCE_S, click, pixels_of, text, told, wait
from support.localization_world import drive as flat_drive
from support.localization_world import flat_map
from support.loops import PROVOKED
from support.recorded import map_with_history


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A flat's map and a drive in it."""
    folder = tmp_path_factory.mktemp("flat")
    write_map(folder / "flat.yaml", flat_map())
    log = flat_drive(1, OdometryNoise())
    write_carmen(folder / "flat.clf", log.measurements)
    write_tum(folder / "truth.tum", log.truth)
    return folder


def test_particles_are_seen_to_converge(browser, place, screenshot):
    grid = flat_map()
    with LivePage("flat.clf", LiveOptions(port=0, speed=5.0), range_max_m=30.0, known=grid) as page:
        browser.get(page.url)
        wait(lambda: int(told(browser).get("tiles", "0")) > 10, "the map is there before the first scan")
        given = {"seed": 2, "observers": [page.observer], "gate": page.pace}
        found = threading.Thread(target=localize, args=(place / "flat.clf", grid), kwargs=given)
        found.start()
        wait(lambda: told(browser)["stage"] == "looking", "an update")
        screenshot("lost")
        wait(lambda: pixels_of(browser, "particle"), "the cloud is everywhere")
        wait(lambda: told(browser)["stage"] == "running", "it is found")
        screenshot("found")
        wait(lambda: pixels_of(browser, "particle"), "the cloud is where the robot is")
        assert text(browser, "[data-value=lost_probability]").endswith(" %")
        page.observer.speed = None
        found.join(PATIENCE_S)
        wait(lambda: told(browser)["stage"] == "writing", "the end")
        wait(lambda: pixels_of(browser, "path") > 100, "the way")
        screenshot("done")


def seek(browser, at):
    script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
    browser.execute_script(script, browser.find_element("id", "line"), at)


def test_a_mapped_run_has_a_time_line(browser, drive, tmp_path, screenshot):
    write_carmen(tmp_path / "loop.clf.gz", drive[:200])
    map_with_history(tmp_path / "loop.clf.gz", tmp_path / "out", configuration=PROVOKED, repair="none")
    with PageServer(Replay(tmp_path / "out"), LiveOptions(port=0)) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("tiles", "0") != "0", "the map")
        line = browser.find_element("id", "line")
        last = int(line.get_attribute("max"))
        assert int(line.get_attribute("value")) == last

        def time_of():
            return browser.find_element("css selector", "#time output").text

        end = time_of()
        seek(browser, 20)
        wait(lambda: time_of() != end and int(line.get_attribute("value")) == 20, "the time line")
        screenshot("early")
        click(browser, "pause")
        wait(lambda: int(line.get_attribute("value")) > 25, "it plays")
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "paused", "it pauses")
        record = json.loads((tmp_path / "out" / "run.json").read_text())["scans"]["used"]
        assert last == record - 1
        screenshot("later")
