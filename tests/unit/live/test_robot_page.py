"""The page of a robot: it drives on, its sessions begin with an empty page, and what is wrong is read there."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from gridslam.cli.ros import make_viewer_opener
from gridslam.config import build
from gridslam.live.control import RobotControl
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from gridslam.localization import KnownMap, MonteCarloConfiguration
from gridslam.messages import Messages
from gridslam.pipeline import run
from gridslam.ros import NodeCore, NodeSettings
from gridslam.ros.node.session import Localization
from support.localization_world import drive as localized_drive
from support.localization_world import flat_map
from support.loops import PROVOKED, loop_drive
from support.page_client import PageClient
from support.ros_node import RecordedOutputs, mounting, play, until


@pytest.fixture(scope="module")
def drive():
    return loop_drive().measurements[:60]


class Robot:
    """Scans are left out or not."""

    def __init__(self) -> None:
        self.paused = False
        self.control = RobotControl(lambda: self.paused, self.pause)

    def pause(self, paused):
        self.paused = paused


def mapped(source, observe):
    return run(source, build(replace(PROVOKED, particles=4)), rng=np.random.default_rng(1), observers=[observe])


def test_a_robot_is_paused_by_its_page_and_seen_paused_but_not_held_back(drive):
    robot, seen = Robot(), PageClient()
    with LivePage("robot", LiveOptions(port=0), robot=robot.control) as page:
        mapped(page.follow_session(drive[:10]), page.observer)
        with connect(page.url.replace("http", "ws", 1) + "socket", max_size=None) as line:

            def told(key):
                seen.receive(line.recv(10))
                line.send(json.dumps({"do": "ack"}))
                return seen.status.get(key)

            assert until(lambda: told("stage") in ("running", "waiting"))
            line.send(json.dumps({"do": "pause"}))
            assert until(lambda: told("stage") == "paused")
            assert robot.paused
            robot.paused = False  # by its service
            page.show_state("no transforms", "missing transform: laser")
            assert until(lambda: told("state") == "missing transform: laser")
            assert seen.status["stage"] == "no transforms"
            messages = Messages(lambda level, text: None)
            messages("late scans", "by 2 s")
            page.show_messages(messages.to_list())
            assert until(
                lambda: told("stage") and [message["text"] for message in seen.reported] == ["late scans: by 2 s"]
            )
            line.send(json.dumps({"do": "step", "to_key_scan": True}))
            with pytest.raises(ConnectionClosed, match="a robot drives on"):
                until(lambda: told("stage") == "stepped")


def test_a_node_is_placed_by_its_page(capsys):
    log, outputs, seen = localized_drive(3), RecordedOutputs(), PageClient()
    known = Localization(KnownMap(flat_map()), MonteCarloConfiguration())
    core = NodeCore(NodeSettings(queue_s=60.0), known, outputs)
    core.on_transforms([mounting(0.0, 0.0)._replace(pose=(0.0,) * 6 + (1.0,))], static=True)
    with make_viewer_opener("robot", LiveOptions(port=0, controls=True))(core):
        url = capsys.readouterr().err.split("live at ")[1].split()[0]
        with connect(url.replace("http", "ws", 1) + "socket", max_size=None) as line:

            def told():
                seen.receive(line.recv(10))
                line.send(json.dumps({"do": "ack"}))
                return seen.status

            def command(**given):
                line.send(json.dumps({"do": "robot"} | given))

            told()
            assert seen.run_info["commands"] == ["set_pose", "locate"]
            core.start()
            play(core, outputs, log.measurements[:20], shift_ns=10**18, ahead=5)
            command(command="set_pose", pose=[1e6, 0, 0])
            assert until(lambda: "in the map" in told()["answer"] or "within" in told()["answer"])
            command(command="set_pose", pose=log.truth.poses[19].tolist())
            assert until(lambda: "pose set to" in told()["answer"])
            play(core, outputs, log.measurements[20:40], shift_ns=10**18, ahead=5)
            assert until(lambda: told()["scans"] == 40)
            assert seen.status["lost"] is False
            assert np.hypot(*(np.array(seen.status["pose"]) - log.truth.poses[39])[:2]) < 0.3
        core.close()
