"""The console of a robot, and the past of a run that goes on, in a real browser."""

import numpy as np
import pytest

from gridslam.live.control import RobotCommands, RobotControl
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from support.browsing import (
    PATIENCE_S,
    Mapping,
    check_by_axe,
    click,
    move_fingers,
    on_screen,
    shown,
    text,
    told,
    view,
    wait,
    wait_for_all,
)
from support.localization_world import flat_map

SESSION = "serialize", "go_on"


class Robot:
    """Notes what it is made to do."""

    def __init__(self, *names):
        self.done = []
        every = {
            "set_pose": self.done.append,
            "locate": lambda: self.done.append("locate"),
            "reset": lambda: self.done.append("reset"),
            "save": lambda session: (True, "12 scans: /out"),
            **{name: lambda session, name=name: self.note(name, session) for name in SESSION},
        }
        commands = RobotCommands(**{name: every[name] for name in names})
        self.control = RobotControl(lambda: False, lambda paused: None, commands)

    def note(self, name, session):
        self.done.append((name, session))
        return True, f"{name} of {session}"


def on_map(browser, robot):
    page = LivePage("robot", LiveOptions(port=0), known=flat_map(), robot=robot.control)
    page.__enter__()
    browser.get(page.url)
    wait(lambda: told(browser).get("tiles", "0") != "0", "the map")
    return page


def test_the_pose_is_set_by_a_drag(browser, screenshot):
    from selenium.webdriver import ActionChains

    robot = Robot("set_pose", "locate")
    page = on_map(browser, robot)
    assert not shown(browser, "reset")
    here = view(browser)
    place, ahead = (here[0] + 0.5, here[1] - 0.5), (here[0] + 0.5, here[1] + 1.5)
    canvas = browser.find_element("id", "map")
    middle = canvas.size["width"] / 2, canvas.size["height"] / 2
    offsets = [[round(a - b) for a, b in zip(on_screen(browser, *at), middle, strict=True)] for at in (place, ahead)]
    click(browser, "set_pose")
    drag = ActionChains(browser).move_to_element_with_offset(canvas, *offsets[0]).click_and_hold()
    drag.move_to_element_with_offset(canvas, *offsets[1]).perform()
    screenshot("dragging")
    ActionChains(browser).release().perform()
    wait(lambda: robot.done, "the pose is sent")
    pose, _ = robot.done[0]
    assert pose == pytest.approx([*place, np.pi / 2], abs=0.05)
    wait(lambda: "pose set to" in text(browser, "#answer"), "an answer")
    assert (view(browser) == here).all(), "the map was not moved"
    click(browser, "locate")
    wait(lambda: robot.done[1:] == ["locate"], "located anywhere")
    page.__exit__()


def test_the_pose_is_set_by_a_finger(phone):
    robot = Robot("set_pose")
    page = on_map(phone, robot)
    click(phone, "sheet")
    click(phone, "set_pose")
    wait(lambda: not shown(phone, "panel"), "the map is not covered")
    place = view(phone)[:2]
    begin = on_screen(phone, *place)
    move_fingers(phone, [begin], [(begin[0] - 80, begin[1])])
    wait(lambda: robot.done, "the pose is sent")
    pose, _ = robot.done[0]
    assert pose[:2] == pytest.approx(place, abs=0.1)
    assert abs(pose[2]) == pytest.approx(np.pi, abs=0.1)
    page.__exit__()


def test_a_reset_is_asked_for_twice_and_the_map_is_saved(browser, screenshot):
    robot = Robot("reset", "save")
    page = on_map(browser, robot)
    assert not shown(browser, "set_pose")
    click(browser, "reset")
    assert "really" in text(browser, "#reset")
    screenshot("sure")
    assert robot.done == []
    click(browser, "reset")
    wait(lambda: robot.done == ["reset"], "it is reset")
    click(browser, "save-robot")
    wait(lambda: "12 scans" in text(browser, "#answer"), "it is saved")
    page.__exit__()


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


def test_sessions_are_saved_and_continued_by_buttons(browser, screenshot):
    """Named by what is typed, whose letters are no keys of the page."""
    robot = Robot(*SESSION)
    page = LivePage("robot", LiveOptions(port=0), robot=robot.control)
    with page:
        browser.get(page.url)
        field = wait(lambda: shown(browser, "session-name") and browser.find_element("id", "session-name"), "the name")
        field.click()
        field.send_keys("mf ground")
        for number, name in enumerate(SESSION, 1):
            click(browser, name)
            wait(lambda number=number: len(robot.done) == number, name)
            wait(lambda name=name: f"{name} of mf ground" in text(browser, "#answer"), "an answer")
        assert robot.done == [(name, "mf ground") for name in SESSION]
        screenshot("sessions")
        check_by_axe(browser)
        field.clear()
        field.send_keys("../../etc/map")
        click(browser, "serialize")
        wait(lambda: "in the node's folder" in text(browser, "#answer"), "the refusal")
        assert len(robot.done) == 2
