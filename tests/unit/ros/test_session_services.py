"""A running node saves and loads sessions, and switches between mapping and localizing."""

from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.se2 import between
from gridslam.io.sessions.session_file import read_session
from gridslam.ros.node.messages import Level
from gridslam.ros.node.session_services import MatchType
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.node_faults import RunningNode
from support.ros_node import until


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(1)
    return simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=180), rng)


@pytest.fixture(scope="module")
def drive(log):
    return list(log.measurements)


OFF_M = 0.35
"""The stand-in's laser sits elsewhere than the simulated one, which alone puts mapped poses off by up to 0.25 m."""


def call(node, service, value=None):
    assert until(lambda: service in node.transport.services)
    return node.transport.services[service](SimpleNamespace(data=value))


def ask(node, service, value=None):
    succeeded, message = call(node, service, value)
    assert succeeded, message
    return message


def pose_of(node):
    return node.transport.outputs.poses[-1].pose


def away(node, truth, first, scan):
    """Distance (m, rad) of the node's pose from the true one, both seen from the first scan's."""
    expected = between(truth[first], truth[scan])
    error = between(expected, pose_of(node))
    return float(np.hypot(*error[:2])), abs(float(error[2]))


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


def test_what_is_mapped_is_joined_with_another_session_and_goes_on_from_both(drive, tmp_path):
    """On the page's buttons, too; a session of another place is refused, and mapping goes on."""
    other = RunningNode(save=str(tmp_path / "other.gridslam"))
    other.play(drive[:200])
    other.stop()
    node = RunningNode(out=str(tmp_path / "out"))
    node.play(drive[100:300])
    serve = node.node._services
    folder = tmp_path / "out"
    folder.mkdir(exist_ok=True)
    for name in ("before-merge", "merged"):
        kept = folder / f"{name}.gridslam"
        kept.write_bytes((tmp_path / "other.gridslam").read_bytes())
        with pytest.raises(ArgumentError, match="another name"):
            serve.merge(str(folder / name))
        with pytest.raises(InputError):
            serve.merge(str(tmp_path / "absent"))
        assert kept.read_bytes() == (tmp_path / "other.gridslam").read_bytes()
        assert not [
            path for path in folder.rglob("*") if "before-merge" in path.name and path.name != f"{name}.gridslam"
        ]
        kept.unlink()
    (folder / ".before-merge.gridslam.0123abcd.partial").mkdir()  # as a node leaves it that is killed while it joins
    assert "going on from" in serve.merge(str(tmp_path / "other"))
    assert list(folder.glob(".*.partial")) == []
    joined = read_session(tmp_path / "out" / "merged.gridslam")
    assert len([*joined.drives]) == 2
    assert len(joined.pieces) == 1
    assert len([*read_session(folder / "before-merge.gridslam").drives]) == 1
    assert sorted(path.name for path in folder.glob("*merge*")) == [
        "before-merge.gridslam",
        "merged.gridslam",
    ]
    node.play(drive[300:330])
    log = node.stop()
    assert "looked for in its map" in log
    assert node.error is None


def test_the_robot_is_localized_in_the_map_so_far_and_mapping_goes_on(log, drive, tmp_path):
    node = RunningNode(out=str(tmp_path / "out"), save=str(tmp_path / "s.gridslam"))
    core = node.node.core
    half, later = len(drive) // 2, 3 * len(drive) // 4
    node.play(drive[:half])
    maps = len(node.transport.outputs.maps)
    assert until(lambda: core._session.state is not None and len(node.transport.outputs.poses) == half)
    assert ask(node, "~/localize", True) == "localizing in the map so far"
    assert until(lambda: core.localizes and node.transport.outputs.maps[maps:])
    assert ask(node, "~/localize", True) == "localizing"
    node.play(drive[half:later])
    assert until(lambda: len(node.transport.outputs.poses) >= later - 1)
    metres, radians = away(node, log.truth.poses, 0, later - 1)
    assert metres < OFF_M
    assert radians < 0.05
    frozen = core.dynamic_map()
    assert frozen is node.transport.outputs.maps[-1]
    keys = core._suspended.state.ancestry.steps
    assert ask(node, "~/localize", False) == "mapping goes on"
    node.play(drive[later:])
    assert until(lambda: len(node.transport.outputs.poses) >= len(drive) - 2)
    metres, radians = away(node, log.truth.poses, 0, len(drive) - 1)
    assert metres < OFF_M
    assert radians < 0.05
    text = node.stop()
    assert node.error is None
    assert "failed" not in text
    saved = read_session(tmp_path / "s.gridslam")
    assert saved.run.state.ancestry.steps > keys
    stamps = saved.run.trajectory.online_trajectory().stamps_ns
    assert len(stamps) < len(drive) - (later - half) + 3  # what was driven while localizing is not mapped
    assert saved.pieces == ()


def requests(**fields):
    return SimpleNamespace(**fields)


def test_requests_of_slam_toolbox_are_served_by_their_fields(log, drive, tmp_path):
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
    wrong = requests(filename=name, match_type=9, initial_pose=pose)
    assert services["deserialize_map"](wrong) != (0,)
    there = between(log.truth.poses[0], log.truth.poses[len(drive) // 2])
    turn = SimpleNamespace(x=0.0, y=0.0, z=float(np.sin(there[2] / 2)), w=float(np.cos(there[2] / 2)))
    pose = SimpleNamespace(position=SimpleNamespace(x=float(there[0]), y=float(there[1]), z=0.0), orientation=turn)
    asked = requests(filename=name, match_type=MatchType.LOCALIZE_AT_POSE, initial_pose=pose)
    assert services["deserialize_map"](asked) == (0,)
    assert until(lambda: node.node.core.localizes)
    end = 3 * len(drive) // 4
    node.play(drive[len(drive) // 2 : end], lost=1)
    metres, _ = away(node, log.truth.poses, 0, end - 1)
    assert metres < OFF_M
    assert services["reset"](requests(pause_new_measurements=True)) == (0,)
    assert node.node.core.is_paused
    node.stop()
    assert node.error is None
