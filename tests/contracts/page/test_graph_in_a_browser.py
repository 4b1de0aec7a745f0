"""A pose graph is edited on the page: both scans of an edge are seen, it is rejected, and a scan is put elsewhere."""

import json

import pytest

from gridslam.api.mapping import map_log
from gridslam.api.session import Session
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.g2o import read_g2o
from gridslam.io.sessions.session_file import read_session
from gridslam.live.options import LiveOptions
from gridslam.live.replay import Replay
from gridslam.live.server import PageServer
from support.browsing import check_by_axe, click, on_screen, pixels_of, text, told, wait
from support.loops import PROVOKED


@pytest.fixture(scope="module")
def mapped(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("graph")
    write_carmen(folder / "loop.clf.gz", drive[:300])
    result = map_log(folder / "loop.clf.gz", configuration=PROVOKED, repair="none", keep_particles=True)
    result.save(folder / "out")
    Session.of(result.to_session()).save(folder / "out" / "loop.gridslam")
    return folder / "out"


@pytest.fixture
def page(browser, mapped):
    with PageServer(Replay(mapped, edits_graph=True), LiveOptions(port=0)) as server:
        browser.get(server.url)
        wait(lambda: told(browser).get("tiles", "0") != "0", "the map")
        yield browser


def drag(browser, start, end):
    from selenium.webdriver import ActionChains

    canvas = browser.find_element("id", "map")
    middle = canvas.size["width"] / 2, canvas.size["height"] / 2
    places = [(round(u - middle[0]), round(v - middle[1])) for u, v in (start, end)]
    action = ActionChains(browser).move_to_element_with_offset(canvas, *places[0]).click_and_hold()
    action.move_to_element_with_offset(canvas, *places[1]).pause(0.5).release().perform()


def test_an_edge_is_seen_rejected_and_another_one_added(page, mapped, screenshot):
    page.find_element("css selector", "#residuals li button").click()
    wait(lambda: "of the beams agree" in text(page, "#overlay"), "the score of both scans")
    assert pixels_of(page, "scan") > 20 < pixels_of(page, "particle"), "the newer scan on the older one"
    screenshot("overlay")
    check_by_axe(page)
    click(page, "reject")
    wait(lambda: text(page, "#edits span") == "1 rejected", "an edge less")
    assert len(read_session(mapped / "loop.gridslam", makes_edits=False).edits) == 1
    click(page, "fit")
    click(page, "put")
    poses = read_g2o(mapped / "graph.g2o").graph.poses
    x, y = poses[-5, :2].tolist()
    drag(page, on_screen(page, x, y), on_screen(page, x + 0.3, y - 0.3))
    wait(lambda: "not added yet" in text(page, "#overlay"), "the match where it was put")
    screenshot("put")
    click(page, "add")
    wait(lambda: text(page, "#edits span") == "1 rejected, 1 added", "an edge more")
    edits = read_session(mapped / "loop.gridslam", makes_edits=False).edits
    assert [edit.added is None for edit in edits] == [True, False]
    for left in ("1 rejected", ""):
        click(page, "undo")
        wait(lambda left=left: text(page, "#edits span") == left, "taken back")
    assert read_session(mapped / "loop.gridslam", makes_edits=False).edits == ()


def test_an_edge_is_chosen_on_the_map(page):
    edge = json.loads(page.execute_script("return JSON.stringify(document.querySelector('#residuals li').textContent)"))
    from_, to = (int(word) for word in edge.partition(":")[0].split("–"))
    page.find_element("css selector", "#residuals li button").click()
    wait(lambda: text(page, "#overlay").startswith(f"scans {from_} and {to}"), "the first edge")
    page.find_element("css selector", "#residuals li button").click()
    wait(lambda: text(page, "#overlay") == "", "none")
    assert not page.find_element("id", "reject").is_enabled()
