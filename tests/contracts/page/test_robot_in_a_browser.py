"""The console of a robot, and the past of a run that goes on, in a real browser."""

import json
import threading

import numpy as np
import pytest

from gridslam.api.localization import localize
from gridslam.cli.live import node_page
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.landmarks import write_landmarks
from gridslam.io.maps import write_map
from gridslam.io.trajectories import write_trajectory_csv, write_tum
from gridslam.live.control import RobotCommands, RobotControl
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.live.replay import Replay
from gridslam.live.server import PageServer
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam.landmarks.report import LandmarkMap
from support.browsing import (
    PATIENCE_S,
    Mapping,
    check_by_axe,
    click,
    move_fingers,
    on_screen,
    pixels_of,
    shown,
    text,
    told,
    view,
    wait,
    wait_for_all,
)
from support.landmark_world import ring
from support.localization_world import drive as flat_drive
from support.localization_world import flat_map
from support.loops import PROVOKED
from support.node_faults import QUICK, SHIFT_NS, RunningNode, is_prepared
from support.recorded import map_with_history
from support.ros_node import LocalTransport, mounting, play, until

SESSION = "serialize", "go_on", "merge", "localize"


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


def test_sessions_are_saved_continued_merged_and_localized_in_by_buttons(browser, screenshot):
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
        assert len(robot.done) == 4


def test_the_session_is_named_and_where_the_robot_was_found_is_marked(browser, screenshot, tmp_path, capsys):
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=180), rng)
    drive = list(log.measurements)[:300]
    first = RunningNode(save=str(tmp_path / "floor.gridslam"))
    first.play(drive)
    first.stop()
    transport = LocalTransport()
    given = {**QUICK, "continue": str(tmp_path / "floor.gridslam")}
    core = RosNode(transport, node_parameters(given, "default")).core
    core.on_transforms([mounting()], static=True)
    with node_page(LiveOptions(port=0), "robot", core, None):
        browser.get(capsys.readouterr().err.split("live at ")[1].split()[0])
        core.start()
        shift_ns = SHIFT_NS + 3600 * 10**9
        play(core, transport.outputs, drive[:5], shift_ns=shift_ns)
        assert until(lambda: is_prepared(core), 60.0)
        play(core, transport.outputs, drive[5:30], shift_ns=shift_ns)
        wait(lambda: "looking for the robot in its map" in text(browser, "#goes-on"), "the search")
        wait(lambda: "floor.gridslam 1 drive" in text(browser, "#goes-on"), "the session's name")
        play(core, transport.outputs, drive[30:], shift_ns=shift_ns)
        wait(lambda: "found again after" in text(browser, "#goes-on"), "found again")
        assert shown(browser, "goes-on")
        way = f"found again after {core._session.found_after_m:.1f} m, at "
        assert way in text(browser, "#goes-on")
        screenshot("found")
        core.close()


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
    with LivePage("flat.clf", LiveOptions(port=0), range_max_m=30.0, known=grid) as page:
        browser.get(page.url)
        wait(lambda: int(told(browser).get("tiles", "0")) > 10, "the map is there before the first scan")
        page.control.step(to_key_scan=True)
        given = {"seed": 2, "observers": [page.observer], "gate": page.pace}
        found = threading.Thread(target=localize, args=(place / "flat.clf", grid), kwargs=given)
        found.start()
        wait(lambda: told(browser).get("keys") == "1", "an update")
        assert "elsewhere" not in text(browser, "#stage")
        screenshot("lost")
        wait(lambda: pixels_of(browser, "particle"), "the cloud is everywhere")
        page.control.set_speed(5.0)
        click(browser, "pause")
        wait(lambda: told(browser)["stage"] == "running", "it is found")
        screenshot("found")
        wait(lambda: pixels_of(browser, "particle"), "the cloud is where the robot is")
        assert not shown(browser, "weights")
        assert not browser.find_elements("css selector", "#layers label:not([hidden]) [name=ancestry]")
        assert text(browser, "[data-value=lost_probability]").endswith(" %")
        page.control.end()
        found.join(PATIENCE_S)
        wait(lambda: told(browser)["stage"] == "writing", "the end")
        wait(lambda: pixels_of(browser, "path") > 100, "the way")
        screenshot("done")


def seek(browser, at):
    script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
    browser.execute_script(script, browser.find_element("id", "line"), at)


def test_landmarks_are_seen_with_the_way(browser, place, tmp_path, screenshot):
    log = flat_drive(1)
    spread = np.tile([[0.04, 0.01], [0.01, 0.09]], (6, 1, 1))
    found = LandmarkMap(np.arange(6), ring(6), spread, np.ones(6, np.int64))
    write_landmarks(tmp_path / "landmarks.csv", found)
    covariances = np.tile(np.diag([0.04, 0.01, 0.001]), (len(log.truth), 1, 1))
    write_trajectory_csv(tmp_path / "trajectory.csv", log.truth, covariances)
    (tmp_path / "run.json").write_text('{"schema": "gridslam.landmarks/2", "input": {"path": "park.txt"}}')
    with PageServer(Replay(tmp_path), LiveOptions(port=0)) as page:
        browser.get(page.url)
        wait(lambda: pixels_of(browser, "landmark") > 6 * 30, "six squares")
        assert not shown(browser, "save-map")
        assert "6 landmarks" in text(browser, "#summary")
        screenshot("way")


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
