"""What helps to look at a finished run: keys, measuring, the grid, turning, comparing, charts, and what is saved."""

import shutil

import pytest

from gridslam.config import override
from gridslam.io.carmen.writer import write_carmen
from gridslam.live.options import LiveOptions
from gridslam.live.replay import Replay
from gridslam.live.server import PageServer
from support.browsing import check_by_axe, click, emulated, on_screen, pixels_of, shown, text, told, view, wait
from support.loops import PROVOKED
from support.recorded import map_with_history


@pytest.fixture(scope="module")
def out(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("tools")
    write_carmen(folder / "loop.clf.gz", drive[:200])
    configuration = override(PROVOKED, "particles=4")
    map_with_history(folder / "loop.clf.gz", folder / "out", configuration=configuration, repair="none")
    shutil.copy(folder / "out" / "trajectory.tum", folder / "out" / "truth.tum")
    return folder / "out"


@pytest.fixture
def page(browser, out):
    """A finished run and its truth, from its first key scan on."""
    with PageServer(Replay(out), LiveOptions(port=0)) as server:
        browser.get(server.url)
        wait(lambda: told(browser).get("tiles", "0") != "0", "the map")
        yield browser


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(page, scheme):
    screen = {"width": 1400, "height": 760, "deviceScaleFactor": 1, "mobile": False}
    with emulated(page, screen, scheme):
        check_by_axe(page)
        press(page, "?")
        check_by_axe(page)


def test_axe_finds_nothing_on_a_phone_in_the_dark(phone, out):
    with PageServer(Replay(out), LiveOptions(port=0)) as server:
        phone.get(server.url)
        wait(lambda: told(phone).get("tiles", "0") != "0", "the map")
        check_by_axe(phone)
        click(phone, "sheet")
        check_by_axe(phone)


def at(browser):
    return int(browser.find_element("id", "line").get_property("value"))


def press(browser, *keys):
    from selenium.webdriver import ActionChains

    ActionChains(browser).send_keys(*keys).perform()


def pointer_to(browser, u, v, *, clicks=False):
    from selenium.webdriver import ActionChains

    canvas = browser.find_element("id", "map")
    middle = canvas.size["width"] / 2, canvas.size["height"] / 2
    action = ActionChains(browser).move_to_element_with_offset(canvas, round(u - middle[0]), round(v - middle[1]))
    (action.click() if clicks else action).perform()


def test_arrows_and_ends_move_in_time_and_space_plays(page):
    from selenium.webdriver import ActionChains, Keys

    last = at(page)
    press(page, Keys.HOME)
    wait(lambda: told(page)["at"] == "0", "the beginning")
    press(page, Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    wait(lambda: told(page)["at"] == "2", "two steps on")
    press(page, Keys.ARROW_LEFT)
    wait(lambda: told(page)["at"] == "1", "one back")
    click(page, "fit")  # which has the focus now, and is not what space means
    press(page, " ")
    wait(lambda: told(page)["stage"] == "running", "space plays")
    press(page, " ")
    wait(lambda: told(page)["stage"] == "paused", "and pauses")
    press(page, Keys.END)
    wait(lambda: told(page)["at"] == str(last), "the end")
    speed = page.find_element("id", "speed").get_property("value")
    press(page, Keys.ARROW_UP)
    wait(lambda: page.find_element("id", "speed").get_property("value") != speed, "faster")
    before = view(page)
    ActionChains(page).key_down(Keys.SHIFT).send_keys(Keys.ARROW_LEFT).key_up(Keys.SHIFT).perform()
    wait(lambda: view(page)[0] < before[0], "shift moves the map")


def test_a_key_right_after_a_click_means_the_page(page):
    """However soon it comes: a browser gives input before timers."""
    page.execute_script(
        "const part = document.querySelector('#fit'); part.focus();"
        "for (const name of ['pointerdown', 'pointerup']) part.dispatchEvent(new PointerEvent(name, {bubbles: true}));"
        "part.dispatchEvent(new KeyboardEvent('keydown', {key: ' ', bubbles: true, cancelable: true}));"
    )
    wait(lambda: told(page)["stage"] == "running", "space plays")


def test_steps_add_up_however_late_the_answers_come(page):
    """An older moment that arrives between two keys moves nothing back."""
    from selenium.webdriver import ActionChains, Keys

    press(page, Keys.HOME)
    wait(lambda: told(page)["at"] == "0", "the beginning")
    page.execute_script(
        "const send = WebSocket.prototype.send;"
        "WebSocket.prototype.send = function (text) {"
        "setTimeout(() => this.readyState === 1 && send.call(this, text), 400); };"
    )
    keys = ActionChains(page)
    for _ in range(8):
        keys = keys.send_keys(Keys.ARROW_RIGHT).pause(0.15)
    keys.perform()
    assert at(page) == 8
    wait(lambda: told(page)["at"] == "8", "eight steps on")


def test_speeds_are_in_order_whatever_the_first_one_was(browser, out):
    with PageServer(Replay(out, 20.0), LiveOptions(port=0)) as server:
        browser.get(server.url)
        wait(lambda: told(browser).get("tiles", "0") != "0", "the map")
        values = browser.execute_script(
            "return [...document.querySelectorAll('#speed option')].map((one) => one.value)"
        )
        assert values == ["0.25", "0.5", "1", "2", "5", "10", "20", "30", "100"]
        assert browser.find_element("id", "speed").get_property("value") == "20"


def test_all_keys_are_listed(page, screenshot):
    from selenium.webdriver import Keys

    press(page, "?")
    wait(lambda: shown(page, "help"), "the list of keys")
    screenshot("keys")
    for key in ("space", "→", "Home", "m", "g", "?"):
        assert key in [part.text for part in page.find_elements("css selector", "#help kbd")]
    press(page, Keys.ESCAPE)
    wait(lambda: not shown(page, "help"), "gone")


def test_distances_are_measured_and_places_are_read(page, screenshot):
    here = view(page)
    first, second = (here[0] - 2.0, here[1]), (here[0] + 1.0, here[1] + 4.0)
    pointer_to(page, *on_screen(page, *first))
    x, y = (float(word.split()[1]) for word in text(page, "#cursor").split(", "))
    assert (x, y) == pytest.approx(first, abs=1.5 / here[2])
    press(page, "m")
    for place in (first, second):
        pointer_to(page, *on_screen(page, *place), clicks=True)
    measured = text(page, "#cursor")
    screenshot("measured")
    assert float(measured.partition(" · ")[2].removesuffix(" m")) == pytest.approx(5.0, abs=3.0 / here[2])
    press(page, "m")
    assert "all" not in text(page, "#cursor")


def test_a_grid_and_the_truth_are_shown(page, screenshot):
    page.find_element("css selector", "input[name='path']").click()
    other = wait(lambda: pixels_of(page, "truth"), "the true path")
    press(page, "g")
    wait(lambda: page.find_element("css selector", "input[name='grid']").is_selected(), "the grid")
    screenshot("grid")
    page.find_element("css selector", "input[name='truth']").click()
    wait(lambda: pixels_of(page, "truth") < other, "the true path is hidden")
