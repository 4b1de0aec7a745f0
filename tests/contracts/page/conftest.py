"""A real browser for the page, one for all tests: Chromium without a window.

Needs Chromium, its driver and the package selenium; tests are skipped with the reason where one is missing, and failed
where GRIDSLAM_REQUIRE_BROWSER=1. Screenshots go to the folder GRIDSLAM_SCREENSHOTS, if that is set.
"""

import os
import shutil
from pathlib import Path

import pytest

from support.browsing import emulated
from support.loops import loop_drive

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--hide-scrollbars",
)
# What a browser says of a server that goes away, which is ordinary to the page.
GONE = (
    "ERR_CONNECTION",
    "ERR_EMPTY_RESPONSE",
    "ERR_SOCKET_NOT_CONNECTED",
    "before receiving a handshake response",
    "closed before the connection is established",
)
BROWSERS = "chromium", "chromium-browser", "google-chrome"


def missing():
    """What there is not of all that is needed."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "the package selenium"
    programs = {"chromium": BROWSERS, "chromedriver": ("chromedriver",)}
    return next((what for what, names in programs.items() if not any(map(shutil.which, names))), None)


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    if lacking := missing():
        reason = f"no browser to test the page with: {lacking} is missing"
        pytest.fail(reason) if os.environ.get("GRIDSLAM_REQUIRE_BROWSER") == "1" else pytest.skip(reason)
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    profile = tmp_path_factory.mktemp("profile")
    options = webdriver.ChromeOptions()
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.binary_location = next(filter(None, map(shutil.which, BROWSERS)))
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    driver.set_window_size(1400, 900)
    yield driver
    driver.quit()


@pytest.fixture(autouse=True)
def no_error_in_the_console(browser):
    browser.get_log("browser")
    yield
    said = [entry["message"] for entry in browser.get_log("browser")]
    assert [message for message in said if not any(words in message for words in GONE)] == []


@pytest.fixture
def screenshot(browser, request):
    def take(name):
        if folder := os.environ.get("GRIDSLAM_SCREENSHOTS"):
            Path(folder).mkdir(parents=True, exist_ok=True)
            browser.save_screenshot(str(Path(folder) / f"{request.node.name}-{name}.png"))

    return take


@pytest.fixture
def phone(browser):
    """The same browser as a phone in the dark, 375 x 667, under fingers."""
    screen = {"width": 375, "height": 667, "deviceScaleFactor": 2, "mobile": True}
    home = browser.current_window_handle
    browser.switch_to.new_window("tab")  # what fingers did in another test is forgotten
    with emulated(browser, screen, "dark"):
        yield browser
    browser.close()
    browser.switch_to.window(home)


@pytest.fixture(scope="session")
def drive():
    """A loop, closed in the end."""
    return loop_drive().measurements
