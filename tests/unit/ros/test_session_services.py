"""A running node saves and loads sessions."""

from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.io.sessions.session_file import read_session
from gridslam.ros.node.messages import Level
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.node_faults import RunningNode


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=180), rng)
    return list(log.measurements)


def test_a_session_is_saved_and_loaded_while_the_node_runs(drive, tmp_path):
    node = RunningNode(out=str(tmp_path / "out"))
    node.play(drive[:60])
    name = tmp_path / "floors" / "first"
    serve = node.node._services
    assert f"{name}.gridslam" in serve.serialize(str(name))
    assert len(read_session(f"{name}.gridslam").run.trajectory.keys) == 60
    node.play(drive[60:90])
    assert "going on from" in serve.deserialize(str(name))
    node.play(drive[60:120], lost=1)
    log = node.stop()
    assert "starting a new map: another session" in log
    assert "goes on where it has ended" in log
    whole = read_session(tmp_path / "out" / "autosave.gridslam")
    assert 118 <= len(whole.run.trajectory.keys) <= 120
    before = read_session(tmp_path / "out-1" / "session.gridslam")  # what was mapped when another one was loaded
    assert len(before.run.trajectory.keys) == 90


def requests(**fields):
    return SimpleNamespace(**fields)


def test_requests_of_slam_toolbox_are_served_by_their_fields(drive, tmp_path):
    node = RunningNode(out=str(tmp_path / "out"))
    node.play(drive[: len(drive) // 2])
    offered = node.node._services.of_slam_toolbox()
    services = {name.removeprefix("slam_toolbox/"): serve for name, (_, serve) in offered.items()}
    assert set(services) == {
        *("serialize_map", "deserialize_map", "save_map"),
        *("pause_new_measurements", "clear_changes", "reset"),
    }
    name = str(tmp_path / "floor")
    assert services["serialize_map"](requests(filename=name)) == (0,)
    assert services["serialize_map"](requests(filename="/proc/none/floor")) == (255,)
    assert node.transport.outputs.logs[-1][0] is Level.WARN
    assert node.transport.outputs.logs[-1][1].startswith("request refused: name: expected a file that can be written")
    (tmp_path / "taken.yaml").mkdir()
    assert services["save_map"](requests(name=SimpleNamespace(data=str(tmp_path / "taken")))) == (255,)
    problem = f"request failed: {tmp_path / 'taken.yaml'}: cannot be written: Is a directory"
    assert (Level.ERROR, problem) in node.transport.outputs.logs
    assert services["save_map"](requests(name=SimpleNamespace(data=name))) == (0,)
    assert (tmp_path / "floor.yaml").exists()
    assert services["pause_new_measurements"](requests()) == (True,)
    assert node.node.core.is_paused
    services["pause_new_measurements"](requests())
    assert not node.node.core.is_paused
    assert services["clear_changes"](requests()) == ()
    pose = SimpleNamespace(x=0.0, y=0.0, theta=0.0)
    wrong = requests(filename=str(tmp_path / "none"), match_type=0, initial_pose=pose)
    assert services["deserialize_map"](wrong) != (0,)
    wrong = requests(filename=name, match_type=3, initial_pose=pose)
    assert services["deserialize_map"](wrong) != (0,)
    assert services["reset"](requests(pause_new_measurements=True)) == (0,)
    assert node.node.core.is_paused
    node.stop()
    assert node.error is None
