"""The page shows which session goes on, and where the robot was found again in it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from websockets.sync.client import connect

from gridslam.cli.ros import make_viewer_opener
from gridslam.live.options import LiveOptions
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.node_faults import QUICK, SHIFT_NS, RunningNode, is_prepared
from support.page_client import PageClient
from support.ros_node import LocalTransport, mounting, play, until


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=180), rng)
    return list(log.measurements)[:260]


@pytest.fixture(scope="module")
def session(drive, tmp_path_factory):
    path = tmp_path_factory.mktemp("session") / "floor.gridslam"
    node = RunningNode(save=str(path))
    node.play(drive)
    node.stop()
    return path


def test_a_node_shows_its_session_and_where_the_robot_was_found(drive, session, capsys):
    outputs, seen, states = LocalTransport(), PageClient(), []
    parameters = node_parameters({**QUICK, "continue": str(session), "map_update_interval": 1.0}, "default")
    node = RosNode(outputs, parameters)
    core = node.core
    core.on_transforms([mounting()], static=True)
    with make_viewer_opener("robot", LiveOptions(port=0), None)(core):
        url = capsys.readouterr().err.split("live at ")[1].split()[0]
        with connect(url.replace("http", "ws", 1) + "socket", max_size=None) as line:

            def told():
                seen.receive(line.recv(10))
                line.send(json.dumps({"do": "ack"}))
                states.append((seen.status.get("searches"), seen.status.get("found") is not None))
                return seen.status

            told()
            core.start()
            shift_ns = SHIFT_NS + 3600 * 10**9
            play(core, outputs.outputs, drive[:5], shift_ns=shift_ns)
            assert until(lambda: is_prepared(core), 60.0)
            for first in range(5, len(drive), 10):
                sent = play(core, outputs.outputs, drive[first : first + 10], shift_ns=shift_ns)
                assert until(lambda end=first + sent: told()["scans"] == end), outputs.outputs.warnings()
            assert until(lambda: told()["goes_on"] is not None)
        core.close()
    assert seen.status["goes_on"] == {"name": "floor.gridslam", "drives": ["2023-11-14_22-13-20"]}
    assert (True, False) in states  # it was looked for before
    assert states[-1] == (False, True)
    where, logged = seen.status["found"], core._session.found
    assert logged is not None
    assert where["way_m"] == pytest.approx(logged.way_m, abs=1e-6)
    assert np.hypot(*(logged.pose - where["pose"])[:2]) < 0.3
