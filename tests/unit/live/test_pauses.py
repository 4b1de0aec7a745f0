"""A viewer holds a run up no longer than it looks on: its pause, its steps and its speed end with it."""

import json
import threading
import time

import pytest
from websockets.sync.client import connect

from gridslam.live import viewing
from gridslam.live.control import Control
from gridslam.live.monitor import MappingMonitor
from gridslam.live.observer import LiveObserver
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.live.run import LiveRun
from support.loops import loop_drive


def run_of(control):
    live = LiveRun("loop", control)
    live.observer = LiveObserver(live.apply, Control(), MappingMonitor())
    return live


@pytest.fixture
def control():
    return Control(2.0)


@pytest.fixture
def live(control):
    return run_of(control)


def ask(viewer, what, **values):
    viewer.command({"do": what, **values})


@pytest.mark.parametrize("what", ["pause", "step"])
def test_a_pause_ends_with_its_viewer(live, control, what):
    viewer, other = (live.add_viewer(lambda: None) for _ in range(2))
    ask(viewer, what)
    assert control.paused
    other.close()
    assert control.paused
    viewer.close()
    assert not control.paused


def test_a_run_goes_on_when_its_viewer_closes_or_goes_silent(monkeypatch):
    """The line of the second one stays open, and nothing comes from it."""
    monkeypatch.setattr(viewing, "_SILENCE_S", 0.3)
    monkeypatch.setattr(viewing, "_HEARTBEAT_S", 0.05)
    drive = loop_drive().measurements[:40]
    for silent in (False, True):
        with LivePage("loop", LiveOptions(port=0)) as page:
            taken = []
            run = threading.Thread(target=lambda page=page, taken=taken: taken.extend(page.pace(drive)), daemon=True)
            with connect(page.url.replace("http", "ws", 1) + "socket", max_size=None) as line:
                line.send(json.dumps({"do": "pause"}))
                wait_until(lambda page=page: page.control.paused)
                run.start()
                if silent:
                    wait_until(lambda taken=taken: len(taken) == len(drive))
                else:
                    for _ in range(10):
                        line.recv(5)
                        line.send(json.dumps({"do": "ack"}))
                    assert not taken, "a viewer that is heard of keeps its pause"
            wait_until(lambda taken=taken: len(taken) == len(drive))


def wait_until(condition, at_most_s=10.0):
    until = time.monotonic() + at_most_s
    while not condition():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.005)
