"""The page of a robot: it drives on, its sessions begin with an empty page, and what is wrong is read there."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from gridslam.config import build
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.messages import Messages
from gridslam.pipeline import run
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient
from support.ros_node import until


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements[:60]


def mapped(source, observe):
    return run(source, build(replace(PROVOKED, particles=4)), rng=np.random.default_rng(1), observers=[observe])


def test_a_robot_tells_its_state_and_is_not_held_back(drive):
    seen = PageClient()
    with LivePage("robot", LiveOptions(port=0)) as page:
        mapped(page.follow(drive[:10]), page.observer)
        with connect(page.url.replace("http", "ws", 1) + "socket", max_size=None) as line:

            def told(key):
                seen.receive(line.recv(10))
                return seen.status.get(key)

            assert until(lambda: told("stage") in ("running", "waiting"))
            page.show_state("no transforms", "missing transform: laser")
            assert until(lambda: told("state") == "missing transform: laser")
            assert seen.status["stage"] == "no transforms"
            messages = Messages(lambda level, text: None)
            messages("late scans", "by 2 s")
            page.show_messages(messages.to_list())
            assert until(
                lambda: told("stage") and [message["text"] for message in seen.reported] == ["late scans: by 2 s"]
            )
            line.send(json.dumps({"do": "pause"}))
            with pytest.raises(ConnectionClosed, match="nothing while the filter runs"):
                until(lambda: told("stage") == "paused")
