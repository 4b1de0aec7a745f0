"""What all need to see and to touch: contrast, size, landmarks, notices, and a view of the map without strays."""

import threading

import numpy as np
import pytest

from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.types import OccupancyGrid
from support.browsing import PATIENCE_S, Mapping, click, emulated, shown, told, view, wait, wait_for_all

DESKTOP = {"width": 1400, "height": 760, "deviceScaleFactor": 1, "mobile": False}
PHONE = {"width": 375, "height": 667, "deviceScaleFactor": 2, "mobile": True}


def luminance(colour):
    """Relative luminance of "#rrggbb" (WCAG 2.2)."""
    channels = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
    return float(linear @ (0.2126, 0.7152, 0.0722))


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.fixture
def finished(drive):
    """The page of a short run whose final map has four cells far off, as beams through a window leave them."""
    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page:
        mapping = Mapping(page, drive[:60])
        mapping.join(PATIENCE_S)
        known = np.zeros((3000, 3000), np.bool_)
        known[200:600, 200:1000] = True  # 20 m x 40 m
        known[2900, 2900:2904] = True
        grid = OccupancyGrid(np.where(known, -2.0, 0.0).astype(np.float32), known, 0.05, (-20.0, -20.0))
        page.finish(grid, mapping.state.ancestry.trajectory(0), np.zeros((0, 4)))
        threading.Thread(target=page.serve_until_left, daemon=True).start()
        yield page


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_free_is_told_from_unknown_and_words_from_the_map(browser, drive, scheme, screenshot):
    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page, emulated(browser, DESKTOP, scheme):
        browser.get(page.url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait_for_all(browser)
        style = "const style = getComputedStyle(document.documentElement);"
        colour = browser.execute_script(
            f"{style} return Object.fromEntries(arguments[0].map((name) => "
            "[name, style.getPropertyValue('--' + name).trim()]));",
            ["free", "unknown", "occupied", "text", "path", "scan", "closure", "particle"],
        )
        screenshot(scheme)
        assert contrast(colour["free"], colour["unknown"]) >= 1.5
        assert contrast(colour["text"], colour["unknown"]) >= 4.5, "the scale is written on the map"
        for name in ("occupied", "path", "scan", "closure", "particle"):
            assert contrast(colour[name], colour["free"]) >= 3, name


@pytest.mark.parametrize("screen", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_what_is_touched_is_24_px_large_and_all_lies_in_landmarks(browser, drive, screen):
    with LivePage("loop.clf", LiveOptions(port=0), range_max_m=30.0) as page, emulated(browser, screen, "light"):
        browser.get(page.url)
        Mapping(page, drive[:60]).join(PATIENCE_S)
        wait_for_all(browser)
        if not shown(browser, "panel"):
            click(browser, "sheet")
        small = browser.execute_script(
            "return [...document.querySelectorAll('button, select, input, a')].filter((part) => part.checkVisibility())"
            ".map((part) => [part.id || part.name, (part.closest('label') ?? part).getBoundingClientRect()])"
            ".filter(([, box]) => box.width < 24 || box.height < 24)"
            ".map(([name, box]) => [name, box.width, box.height])"
        )
        assert small == []
        outside = browser.execute_script(
            "return [...document.body.children].map((part) => part.tagName)"
            ".filter((name) => !['HEADER', 'MAIN', 'ASIDE', 'FOOTER', 'DIALOG'].includes(name))"
        )
        assert outside == []
        assert len(browser.find_elements("tag name", "main")) == 1


def test_the_whole_map_is_that_of_the_robot_not_of_strays(browser, finished):
    browser.get(finished.url)
    wait(lambda: told(browser).get("stage") == "finished", "the end")
    wait_for_rest = view(browser)
    wait(lambda: np.array_equal(wait_for_rest, view(browser)), "the camera rests")
    x, y, scale = view(browser)[:3]
    assert (x, y) == pytest.approx((10.0, 0.0), abs=3.0)  # the path goes farther than the map
    assert scale > 15, "40 m on a screen"
