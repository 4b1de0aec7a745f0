"""The page and its line, in a real browser: lost and back, a server's restart, and a robot's page."""

import time
from dataclasses import replace

import numpy as np

from gridslam.config import build
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.messages import Level, Messages
from gridslam.pipeline import run
from support.browsing import PATIENCE_S, Cable, Mapping, check_by_axe, click, shown, text, told, wait, wait_for_all
from support.loops import PROVOKED


def port_of(page):
    return int(page.url.rstrip("/").rpartition(":")[2])


def test_a_restart_of_the_server_is_outlived(browser, drive, screenshot):
    with LivePage("before", LiveOptions(port=0), range_max_m=30.0) as page:
        url, port = page.url, port_of(page)
        browser.get(url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        session = wait(lambda: told(browser).get("tiles", "0") != "0" and told(browser)["session"], "a map")
    wait(lambda: told(browser)["stage"] == "offline", "the page notices")
    assert "trying again" in text(browser, "#notice")
    screenshot("offline")
    with LivePage("after", LiveOptions(port=port), range_max_m=30.0) as page:
        wait(lambda: told(browser)["session"] != session, "the page is back")
        assert text(browser, "#title") == "after"
        assert told(browser)["tiles"] == "0", "the map of the run before is still there"
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait(lambda: int(told(browser)["tiles"]) > 0, "the new map")
        assert not shown(browser, "notice")


def test_a_line_that_is_lost_comes_back_to_the_same_run(browser, drive, screenshot):
    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        cable = Cable(port_of(page))
        browser.get(f"http://127.0.0.1:{cable.port}/")
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait_for_all(browser)
        had = {key: told(browser)[key] for key in ("session", "keys", "tiles")}
        cable.cut()
        wait(lambda: told(browser)["stage"] == "offline", "the page notices")
        wait(lambda: page.viewers == 0, "so does the server")
        cable.mend()
        wait(lambda: told(browser)["stage"] != "offline", "the page is back by itself")
        wait(lambda: not shown(browser, "notice"), "nothing is said any more")
        wait(lambda: had.items() <= told(browser).items(), "and has what it had")
        cable.close()


def test_a_line_that_dies_without_a_word_is_given_up(browser, drive):
    """As a phone's that has left the network: the page hears nothing, and comes back when it can."""
    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        cable = Cable(port_of(page))
        browser.get(f"http://127.0.0.1:{cable.port}/")
        wait(lambda: told(browser).get("stage") == "waiting", "the page is connected")
        time.sleep(5.0)
        assert told(browser)["stage"] == "waiting", "that nothing happens is no silence"
        cable.hush()
        wait(lambda: told(browser)["stage"] == "offline", "the page notices")
        cable.mend()
        wait(lambda: told(browser)["stage"] == "waiting", "the page is back by itself")
        cable.close()


def test_a_robot_is_not_held_up_and_what_is_wrong_is_read(browser, drive, screenshot):
    from selenium.webdriver import Keys

    with LivePage("ROS 1", LiveOptions(port=0), range_max_m=30.0) as page:
        browser.get(page.url)
        wait(lambda: told(browser).get("stage") == "waiting", "the page is connected")

        def mapped(part):
            rng, observers = np.random.default_rng(1), [page.observer]
            run(page.follow(part), build(replace(PROVOKED, particles=8)), rng=rng, observers=observers)
            page.show_state("running", "mapping")

        messages = Messages(lambda level, text: None)
        messages.report(Level.ERROR, "starting a new map: time jumped back, and the robot is elsewhere")
        messages("two transforms", "odom is published twice")
        messages.report(Level.WARN, "no transform from 'laser' to 'base_link'", is_state=True)
        page.show_messages(messages.to_list())
        page.show_state("no transforms", "no transform from 'laser' to 'base_link'")
        wait(lambda: shown(browser, "notice"), "what is wrong")
        assert text(browser, "#notice span").startswith("starting a new map"), "a lesser one that is newer hides none"
        assert text(browser, "#stage") == "no transform from 'laser' to 'base_link'"
        browser.refresh()
        wait(lambda: shown(browser, "notice"), "it survives a reload")
        click(browser, "messages")
        found = [item.text for item in browser.find_elements("css selector", "#messages li")]
        assert [line.split(" ", 2)[-1].split(":")[0] for line in found] == ["warning", "warning", "error"]
        screenshot("messages")
        mapped(drive[:60])
        session = wait(lambda: int(told(browser)["tiles"]) > 10 and told(browser)["session"], "a map")
        browser.find_element("css selector", "#notice button").click()
        wait(lambda: not shown(browser, "notice"), "it is put away")
        buttons = "pause", "step", "speed", "line", "follow"
        assert [name for name in buttons if shown(browser, name)] == ["follow"]
        browser.find_element("tag name", "body").send_keys(".", Keys.HOME)  # the keys of a time line do nothing
        mapped(drive[60:64])
        wait(lambda: told(browser)["session"] != session, "another session")
        wait(lambda: int(told(browser)["tiles"]) > 0, "its map")
        assert int(told(browser)["keys"]) < 5


def test_what_was_put_away_stays_so_however_often_it_comes(browser):
    """After a reload, too; another message is shown."""
    messages = Messages(lambda level, text: None)
    with LivePage("ROS 1", LiveOptions(port=0)) as page:
        for _ in range(2):
            messages("two transforms", "odom is published twice")
            page.show_messages(messages.to_list())
            browser.get(page.url)
            wait(lambda: shown(browser, "messages"), "the list")
            if messages.to_list()[0]["count"] == 1:
                browser.find_element("css selector", "#notice button").click()
            assert not shown(browser, "notice")
        messages("two transforms", "odom is published twice")
        page.show_messages(messages.to_list())
        click(browser, "messages")
        wait(lambda: "(3 times)" in text(browser, "#messages"), "it comes again")
        assert not shown(browser, "notice")
        messages("late scans", "by 3 s")
        page.show_messages(messages.to_list())
        wait(lambda: "late scans" in text(browser, "#notice"), "another one is shown")
        messages("clock differs", "by 5 s")
        messages("late scans", "by 3 s")
        page.show_messages(messages.to_list())
        wait(lambda: "clock differs" in text(browser, "#notice"), "two that last do not alternate")


def test_a_long_list_of_messages_is_scrolled_by_keys(browser):
    from selenium.webdriver import Keys

    messages = Messages(lambda level, text: None)
    for letter in "abcdefghijklmnopqrstuvwxyz":
        messages(f"problem {letter}", "a sentence about it")
    with LivePage("ROS 1", LiveOptions(port=0)) as page:
        page.show_messages(messages.to_list())
        browser.get(page.url)
        wait(lambda: shown(browser, "messages"), "the list")
        click(browser, "messages")
        wait(lambda: len(browser.find_elements("css selector", "#messages li")) == 26, "all of it")
        entries = browser.find_element("css selector", "#messages ol")
        entries.send_keys(Keys.ARROW_DOWN)
        wait(lambda: browser.execute_script("return arguments[0].scrollTop", entries) > 0, "it is scrolled")
        check_by_axe(browser)
