"""A node's session goes on: at the same place, found again elsewhere, after a kill, and with its own configuration."""

import json
import time

import numpy as np
import pytest

from gridslam.api.mapping import map_log
from gridslam.errors import ConfigurationError, InputError
from gridslam.io.sessions.session_file import read_session
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.interrupted import carry
from support.node_faults import RunningNode, is_prepared
from support.ros_node import LocalTransport, in_filter, until


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return list(log.measurements)


@pytest.fixture(scope="module")
def first_half(drive, tmp_path_factory):
    """Session of a node that was ended after half of the drive."""
    path = tmp_path_factory.mktemp("session") / "s.gridslam"
    node = RunningNode(save=str(path))
    node.play(drive[: len(drive) // 2])
    log = node.stop()
    assert node.error is None
    assert f"session saved: {path}" in log
    return path


def online(path):
    run = read_session(path).run
    trajectory = run.trajectory.online_trajectory()
    return run, trajectory


def test_a_node_goes_on_where_its_session_has_ended(drive, first_half, tmp_path):
    node = RunningNode(**{"continue": str(first_half)}, save=str(tmp_path / "whole.gridslam"), particles=7)
    node.play(drive[len(drive) // 2 :])
    log = node.stop()
    assert f"session {first_half}: goes on where it has ended: the first scan is" in log
    assert "ignored parameters: particles (the session's own configuration is used)" in log
    one = RunningNode(save=str(tmp_path / "one.gridslam"))
    one.play(drive)
    one.stop()
    (ours, trajectory), (expected, expected_trajectory) = map(
        online, (tmp_path / "whole.gridslam", tmp_path / "one.gridslam")
    )
    assert len(ours.logs) == 2
    assert len(ours.state.poses) == 3
    assert trajectory.poses.tobytes() == expected_trajectory.poses.tobytes()
    assert ours.rng.bit_generator.state == expected.rng.bit_generator.state


def test_a_robot_that_was_carried_is_found_again_in_the_map(drive, first_half, tmp_path):
    """The second day begins with the same way, an hour later: scans of another stamp and odometry from zero."""
    save = tmp_path / "days.gridslam"
    node = RunningNode(**{"continue": str(first_half)}, save=str(save), out=str(tmp_path / "out"))
    node.play(drive[:5], shift_s=3600.0)
    assert until(lambda: is_prepared(node.node.core), 60.0)
    node.play(drive[5 : len(drive) // 2], shift_s=3600.0)
    log = node.stop()
    assert "goes on elsewhere, the robot is looked for in its map: " in log
    assert "found again in the map of 2023-11-14_22-13-20 after " in log
    saved = read_session(save)
    assert saved.pieces == ()
    assert [drive.name[:16] for drive in saved.drives] == ["2023-11-14_22-13", "2023-11-14_23-13"]
    poses = saved.run.state.best_trajectory()
    half = len(poses) // 2
    gap = np.abs(poses[half + 20 :, :2][:, None] - poses[None, :half, :2]).sum(axis=2).min(axis=1)
    assert gap.max() < 0.6  # the same way: no key scan lies farther from the first day's
    assert len(list((tmp_path / "out").glob("trajectory_2023*.tum"))) == 2


def test_a_robot_that_is_carried_while_the_node_runs_is_found_in_the_map_so_far(drive, tmp_path):
    """Nobody notices: the view changes. A new piece of the map begins there, and is joined with the one before."""
    measurements = carry(drive[:300], drive[60:260])
    out = tmp_path / "out"
    node = RunningNode(out=str(out), save=str(tmp_path / "s.gridslam"), record=str(tmp_path / "r.csv"), autosave=0.002)
    node.play(measurements[:330])
    core, outputs = node.node.core, node.transport.outputs
    assert until(lambda: is_prepared(core), 120.0)
    assert core.diagnostics().values["session"] == "2"
    node.play(measurements[330:])
    log = node.stop()
    assert node.error is None
    assert log.count("the view changes while the odometry is continuous") == 1
    assert "starting a new map: the robot was carried, and is looked for in the map so far" in log
    assert "found again in the map of 2023-11-14_22-13-20 after " in log
    assert len({pose.stamp_ns for pose in outputs.poses}) == len(measurements)
    saved = read_session(tmp_path / "s.gridslam")
    assert saved.pieces == ()
    assert [sum(log.scans for log in drive.logs) for drive in saved.drives] == [300, 200]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "r.csv", "s.gridslam"]
    assert not [*out.glob("autosave*")]
    run = json.loads((out / "run.json").read_text())
    assert len(run["session"]["drives"]) == 2
    again = map_log(tmp_path / "r.csv", configuration=saved.configuration, repair="none")
    assert [len(path) for path in again.trajectories.values()] == [300, 200]


def test_a_carried_robot_that_is_not_found_leaves_two_pieces(drive, tmp_path):
    other = simulate(
        make_world("random", np.random.default_rng(3)),
        RobotConfig(),
        OdometryNoise(),
        LidarConfig(beams=180),
        np.random.default_rng(3),
    )
    node = RunningNode(out=str(tmp_path / "out"))
    node.play(carry(drive[:200], list(other.measurements)[:60]))
    log = node.stop()
    assert "the robot was carried, and is looked for in the map so far" in log
    assert "found again" not in log
    assert (tmp_path / "out" / "map_2.yaml").exists()
    assert len([*(tmp_path / "out").glob("trajectory_2023*.tum")]) == 1


def test_scans_that_are_held_back_while_the_view_changes_are_mapped_where_it_was_no_carry(drive, tmp_path):
    """Somebody stands before the laser for some scans, and leaves; or the node ends before it is certain."""
    measurements = carry(drive[:100], drive[60:100])
    node = RunningNode(out=str(tmp_path / "out"))
    node.play(measurements[:104])
    assert "carried" not in node.stop()
    assert len({pose.stamp_ns for pose in node.transport.outputs.poses}) == 104


def test_a_killed_node_has_left_its_session_and_the_next_one_says_so(drive, tmp_path):
    out = tmp_path / "out"
    node = RunningNode(out=str(out), autosave=0.002)
    node.play(drive[:60])
    autosave = out / "autosave.gridslam"
    assert until(autosave.exists)
    left = read_session(autosave)  # as if killed now
    kept = autosave.read_bytes()
    node.stop()
    autosave.write_bytes(kept)
    assert 1 <= len(left.run.trajectory.keys) <= 60
    again = RunningNode(out=str(out), autosave=0.002)
    again.play(drive[:30])
    assert until(lambda: (out / "autosave-1.gridslam").exists())
    log = again.stop()
    assert f"--continue {autosave} goes on from it" in log
    assert (out / "autosave-1.gridslam").read_bytes() == kept  # nothing is lost
    third = RunningNode(**{"continue": str(autosave)}, out=str(out), autosave=0.002)
    third.play(drive[30:60])
    log = third.stop()
    assert "is the session of an earlier node" not in log
    assert "goes on where it has ended" in log
    assert not (out / "autosave-2.gridslam").exists()
    assert len(read_session(autosave).run.trajectory.keys) == 60


def test_nothing_replaces_a_session_that_cannot_be_gone_on_from(drive, first_half, tmp_path, monkeypatch):
    def fail(*arguments, **options):
        raise RuntimeError("injected")

    monkeypatch.setattr("gridslam.ros.node.continued.locate_in", fail)
    path = tmp_path / "s.gridslam"
    path.write_bytes(first_half.read_bytes())
    node = RunningNode(**{"continue": str(path)}, save=str(path), out=str(tmp_path / "out"))
    node.play(drive[:30], shift_s=86_400.0)
    assert until(lambda: is_prepared(node.node.core), 60.0)
    node.play(drive[30:40], shift_s=86_400.0)
    log = node.stop()
    assert "injected" in log
    assert "no session is saved" in log
    assert path.read_bytes() == first_half.read_bytes()
    assert (tmp_path / "out" / "map.pgm").exists()  # the drive is not lost, either


def test_where_time_jumps_back_the_next_drive_belongs_to_the_same_session(drive, first_half, tmp_path):
    """A bag that is played again, or a clock that was set: what the session holds is neither lost nor replaced."""
    path = tmp_path / "s.gridslam"
    path.write_bytes(first_half.read_bytes())
    node = RunningNode(**{"continue": str(path)}, save=str(path))
    node.play(drive[len(drive) // 2 : len(drive) // 2 + 20])
    node.play(drive[:20])
    log = node.stop()
    assert node.error is None
    assert "goes on elsewhere" in log
    saved = read_session(path)
    lengths = [sum(log.scans for log in drive.logs) for drive in saved.drives]
    assert lengths == [len(drive) // 2 + 20, 19]
    assert not path.with_stem("s-1").exists()
    other = RunningNode(save=str(path))  # has nothing to do with the file that is there
    other.play(drive[20:40])
    other.play(drive[:20])
    log = other.stop()
    assert [sum(log.scans for log in drive.logs) for drive in read_session(path).drives] == [20, 19]
    assert len([*read_session(path.with_stem("s-1")).drives]) == 2


def test_a_reset_before_the_first_scan_forgets_the_session_that_was_to_go_on(drive, first_half, tmp_path):
    node = RunningNode(**{"continue": str(first_half)}, save=str(tmp_path / "new.gridslam"))
    node.node.core.reset()
    assert until(lambda: "starting a new map: reset" in node.transport.outputs.warnings())
    node.play(drive[200:210])
    node.stop()
    assert len([*read_session(tmp_path / "new.gridslam").drives]) == 1


def test_a_reset_keeps_the_session_so_far_beside_the_new_one(drive, first_half, tmp_path):
    path = tmp_path / "s.gridslam"
    path.write_bytes(first_half.read_bytes())
    node = RunningNode(**{"continue": str(path)}, save=str(path), out=str(tmp_path / "out"))
    node.play(drive[len(drive) // 2 : len(drive) // 2 + 5])
    node.node.core.reset()
    node.play(drive[len(drive) // 2 + 5 : len(drive) // 2 + 15], lost=1)
    log = node.stop()
    assert f"the earlier session {path} is kept as {path.with_stem('s-1')}" in log
    assert path.with_stem("s-1").read_bytes() == first_half.read_bytes()
    assert len(read_session(path).run.trajectory.keys) in (9, 10)


@pytest.mark.parametrize("minutes", [-1.0, "often"])
def test_an_autosave_that_is_no_time_is_refused(minutes):
    with pytest.raises(ConfigurationError, match="autosave: expected a number of minutes"):
        node_parameters({"autosave": minutes}, "default")


def test_a_session_that_is_none_is_refused_at_the_start(tmp_path):
    (tmp_path / "s.gridslam").write_bytes(b"no session")
    with pytest.raises(InputError, match=r"s\.gridslam: expected a session of gridslam"):
        node_parameters({"continue": str(tmp_path / "s.gridslam")}, "default")
    with pytest.raises(InputError, match="no such file"):
        node_parameters({"continue": str(tmp_path / "other.gridslam")}, "default")


def test_a_live_scan_is_not_held_up_while_the_session_is_written(drive, tmp_path):
    """Saving costs the filter's thread the copies of tables: 50 ms at most."""
    node = RosNode(LocalTransport(), node_parameters({"out": str(tmp_path / "out"), "particles": 3}, "default"))
    assert node.core._autosave is not None
    node.close()
    running = RunningNode(out=str(tmp_path / "out"), autosave=0.0)
    running.play(drive[:60])
    core = running.node.core

    def copy():
        begin = time.thread_time()
        return core._session.copy(None), time.thread_time() - begin

    copied, seconds = in_filter(core, copy)
    assert seconds < 0.05
    running.stop()
    assert copied.log.scan_count == 60
    assert not (tmp_path / "out" / "autosave.gridslam").exists()  # 0 minutes: none
