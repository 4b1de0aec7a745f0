"""What viewers may make a robot do: only what is offered, only from the page itself, and with an answer."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from gridslam.errors import ArgumentError
from gridslam.live.control import RobotCommands, RobotControl
from gridslam.live.options import LiveOptions
from gridslam.live.page import LivePage
from support.page_client import PageClient


class Robot:
    """Notes what it is made to do."""

    def __init__(self, refuses: str = "") -> None:
        self.done, self.refuses, self.saving = [], refuses, threading.Event()
        self.commands = RobotCommands(self.set_pose, lambda: self.done.append("locate"), None, self.save)

    def set_pose(self, pose):
        if self.refuses:
            raise ArgumentError("pose", "a pose in the map", self.refuses)
        self.done.append(pose)

    def save(self, session):
        assert session == ""
        assert self.saving.wait(10)
        return True, "12 scans: /out"

    def control(self):
        return RobotControl(lambda: False, lambda paused: None, self.commands)


def execute(control, **command):
    answers = []
    control.execute(command, answers.append)
    return answers


def test_a_pose_is_set_with_the_covariance_of_a_hand():
    robot = Robot()
    assert execute(robot.control(), command="set_pose", pose=[1, 2.5, -0.5]) == ["pose set to 1.00 m, 2.50 m, -29°"]
    pose, covariance = robot.done[0]
    assert pose.tolist() == [1, 2.5, -0.5]
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.5, 0.5, np.pi / 12])
    assert execute(robot.control(), command="locate")
    assert robot.done[1:] == ["locate"]


@pytest.mark.parametrize(
    "command",
    [
        {"command": "reset"},  # which is not offered
        {"command": "__class__"},
        {"command": None},
        {"command": "set_pose"},
        {"command": "set_pose", "pose": [1, 2]},
        {"command": "set_pose", "pose": "abc"},
        {"command": "set_pose", "pose": [1, 2, {}]},
        {},
    ],
)
def test_what_is_not_offered_is_refused(command):
    robot = Robot()
    with pytest.raises((ArgumentError, KeyError, TypeError, ValueError)):
        execute(robot.control(), **command)
    assert robot.done == []


def test_one_saves_at_a_time_and_nobody_waits():
    robot, answers = Robot(), []
    control, ended = robot.control(), threading.Event()

    def answer(text):
        answers.append(text)
        if text.startswith("saved"):
            ended.set()

    control.execute({"command": "save"}, answer)
    control.execute({"command": "save"}, answer)
    assert answers == ["saving", "still at work on the command before"]
    robot.saving.set()
    assert ended.wait(10)
    assert answers[2:] == ["saved: 12 scans: /out"]


@pytest.mark.parametrize("session", ["../x", "/etc/x", "a/b", 3, None, ["x"]])
def test_a_session_outside_the_folder_is_refused(session):
    robot = Robot()
    (told,) = execute(robot.control(), command="save", session=session)
    assert told.startswith("not saved: expected the name of a session in the node's folder")


@pytest.mark.parametrize(("origin", "is_obeyed"), [("http://evil.example", False), (None, True)])
def test_only_the_page_itself_commands(origin, is_obeyed):
    robot = Robot()
    with LivePage("robot", LiveOptions(port=0), robot=robot.control()) as page:
        page._run.observer.history.reset()
        options = {} if origin is None else {"origin": origin}
        with connect(page.url.replace("http", "ws", 1) + "socket", **options) as line:
            client = PageClient()
            try:
                line.send(json.dumps({"do": "robot", "command": "locate"}))
                while client.status.get("answer") != "the robot is being located":
                    client.receive(line.recv(5))
                    line.send(json.dumps({"do": "ack"}))
            except ConnectionClosed:
                assert not is_obeyed
    assert robot.done == ["locate"] * is_obeyed
