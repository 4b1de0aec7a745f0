"""The site of docs in a browser: no column is cut off at any width of the window."""

import pytest

RIGHT_EDGES = """return [".sidebar-drawer", ".content", ".toc-drawer"].map(
    (name) => document.querySelector(name).getBoundingClientRect().right - document.documentElement.clientWidth)"""
AS_FURO_HAS_IT = """const style = document.createElement("style");
style.textContent = ".main, .content { min-width: auto } .sidebar-drawer { width: calc(50% - 26em) }";
document.head.append(style)"""


@pytest.mark.parametrize("width", [1330, 1366, 1440, 1536, 1920])
def test_all_columns_fit(browser, site, width):
    browser.set_window_size(width, 900)
    try:
        browser.get((site.html / "models.html").as_uri())
        assert max(browser.execute_script(RIGHT_EDGES)) <= 0
        if width in (1366, 1440):  # as the theme has it, the third column was cut off
            browser.execute_script(AS_FURO_HAS_IT)
            assert max(browser.execute_script(RIGHT_EDGES)) > 10
    finally:
        browser.set_window_size(1400, 900)
