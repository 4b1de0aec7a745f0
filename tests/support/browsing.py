"""What the tests of the page do with a browser: wait, look, touch, and cut the line."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from gridslam.config import build
from gridslam.pipeline import run
from support.loops import PROVOKED

PATIENCE_S = 60.0


def told(browser: Any) -> dict[str, str]:
    """What the page knows: numbers and words on its body."""
    return browser.execute_script("return {...document.body.dataset}")


def wait(condition: Callable[[], Any], what: str) -> Any:
    """What a condition comes to, once that is something."""
    until = time.monotonic() + PATIENCE_S
    while not (got := condition()):
        assert time.monotonic() < until, f"it did not happen: {what}"
        time.sleep(0.05)
    return got


def wait_for_all(browser: Any) -> None:
    """Wait until a run has come to its end, all of it is on the page, and the camera rests."""
    wait(lambda: told(browser).get("stage") == "final refinement", "the last scan")
    seen = None
    while seen != (seen := told(browser)):
        time.sleep(0.5)  # of a message at least every 0.1 s


def click(browser: Any, name: str) -> None:
    """Press what has this id."""
    browser.find_element("id", name).click()


def shown(browser: Any, name: str) -> bool:
    """Whether what has this id is seen."""
    return browser.find_element("id", name).is_displayed()


def text(browser: Any, selector: str) -> str:
    """The words in an element."""
    return browser.find_element("css selector", selector).text


def pressed(browser: Any, name: str) -> bool:
    """Whether a button is held down."""
    return browser.find_element("id", name).get_attribute("aria-pressed") == "true"


def view(browser: Any) -> np.ndarray:
    """The camera: x m and y m of its middle, px per m, and where on the screen (px) its middle is."""
    return np.array([float(word) for word in told(browser)["view"].split()])


def colours(browser: Any, selector: str = "#map") -> int:
    """How many colours are on a canvas."""
    return browser.execute_script(f"{_PIXELS} return new Set(pixels).size;", selector)


def pixels_of(browser: Any, name: str, selector: str = "#map") -> int:
    """How many pixels of a canvas have a colour of the style sheet."""
    return browser.execute_script(
        f"{_PIXELS} copy.fillStyle = getComputedStyle(document.documentElement).getPropertyValue('--' + arguments[1]);"
        "copy.fillRect(0, 0, 1, 1);"
        "const colour = new Uint32Array(copy.getImageData(0, 0, 1, 1).data.buffer)[0];"
        "return pixels.filter((pixel) => pixel === colour).length;",
        selector,
        name,
    )


_PIXELS = (  # read from a copy: the browser complains of a canvas that is drawn to and read in turns
    "const canvas = document.querySelector(arguments[0]);"
    "const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext('2d', {willReadFrequently: true});"
    "copy.drawImage(canvas, 0, 0);"
    "const pixels = new Uint32Array(copy.getImageData(0, 0, canvas.width, canvas.height).data.buffer);"
)


def on_screen(browser: Any, x: float, y: float) -> tuple[float, float]:
    """Where a place of the map is on the screen, px."""
    here = view(browser)
    return here[3] + (x - here[0]) * here[2], here[4] - (y - here[1]) * here[2]


def check_by_axe(browser: Any) -> None:
    """Let axe look for what people cannot see, hear or reach: it finds nothing."""
    base = pytest.importorskip("axe_core_python.base")
    found = browser.execute_async_script(f"{base.AXE_SCRIPT}; axe.run().then(arguments[0])")
    assert [(each["id"], each["nodes"][0]["html"]) for each in found["violations"]] == []
    assert len(found["passes"]) > 15, "it has looked"


@contextlib.contextmanager
def emulated(browser: Any, screen: dict[str, Any], scheme: str) -> Iterator[None]:
    """Let a browser have another screen, under fingers, and prefer light or dark."""
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True, "maxTouchPoints": 2})
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    try:
        yield
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def move_fingers(browser: Any, first: list[tuple[float, float]], last: list[tuple[float, float]]) -> None:
    """Put fingers down at places of the screen (px), move each to its last place, and lift them."""
    begin, end = np.array(first, float), np.array(last, float)

    def touch(kind: str, places: Any) -> None:
        points = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(places)]
        browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", begin.tolist())
    for share in np.linspace(0, 1, 11)[1:]:
        touch("touchMove", (begin + share * (end - begin)).tolist())
    touch("touchEnd", [])


class Mapping(threading.Thread):
    """A filter that maps a drive on a page."""

    def __init__(self, page: Any, drive: Any) -> None:
        super().__init__(daemon=True)
        self.page, self.drive, self.state = page, drive, None
        self.start()

    def run(self) -> None:
        slam, rng = build(PROVOKED), np.random.default_rng(1)
        source, observers = self.page.pace(self.drive), [self.page.observer]
        self.state = run(source, replace(slam, particles=8), rng=rng, observers=observers)


class Cable(threading.Thread):
    """A line to a port that can be cut, and mended."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self._to, self._ends, self._server = port, [], socket.create_server(("127.0.0.1", 0))
        self.port, self.is_cut = self._server.getsockname()[1], False
        self._quiet = threading.Event()
        self.start()

    def run(self) -> None:
        with contextlib.suppress(OSError):  # closed
            while True:
                here, _ = self._server.accept()
                if self.is_cut:
                    here.close()
                    continue
                there = socket.create_connection(("127.0.0.1", self._to))
                self._ends += [here, there]
                for pair in ((here, there), (there, here)):
                    threading.Thread(target=self._carry, args=pair, daemon=True).start()

    def cut(self) -> None:
        """Break all connections, and let none be made."""
        self.is_cut = True
        while self._ends:
            with contextlib.suppress(OSError):
                self._ends.pop().shutdown(socket.SHUT_RDWR)

    def hush(self) -> None:
        """Carry no more, and say so to nobody, as radio does."""
        self._quiet.set()

    def mend(self) -> None:
        """Let connections be made again; those that were hushed stay so."""
        self.is_cut, self._quiet = False, threading.Event()

    def close(self) -> None:
        """Carry no more."""
        self.cut()
        self._server.close()

    def _carry(self, source: socket.socket, target: socket.socket) -> None:
        """Carry one way, and end the other one with it; each closes what it reads from."""
        quiet = self._quiet
        with source, contextlib.suppress(OSError):
            try:
                while data := source.recv(65536):
                    if not quiet.is_set():
                        target.sendall(data)
            finally:
                target.shutdown(socket.SHUT_RDWR)
