"""The node without transport: what it says of a drive, its services, and what it survives."""

import threading

import numpy as np
import pytest

from gridslam.api.mapping import map_log
from gridslam.config import Configuration, preset
from gridslam.errors import ConfigurationError, GridslamError
from gridslam.geometry.se2 import compose
from gridslam.io.maps import read_map
from gridslam.ros import NodeCore, NodeSettings
from gridslam.ros.node.messages import Level
from gridslam.ros.node.rendering import map_cells
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.interrupted import carry
from support.ros_node import ODOM, RecordedOutputs, mounting, odometry_message, play, scan_message, until

SHIFT_NS = 1_700_000_000 * 10**9
FEW = Configuration(particles=4)


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return list(log.measurements)[:120]


def node(outputs, *, configuration=FEW, record=None, **settings):
    given = NodeSettings(**{"map_update_interval_s": 0.2, "queue_s": 60.0, **settings})
    core = NodeCore(given, configuration, outputs, record=record)
    core.on_transforms([mounting()], static=True)
    core.start()
    return core


def drive_all(core, outputs, measurements, *, shift_ns=SHIFT_NS):
    done = len(outputs.poses)
    sent = play(core, outputs, measurements, shift_ns=shift_ns)
    assert until(lambda: len(outputs.poses) == done + sent), outputs.warnings()


def test_the_record_of_a_live_run_is_mapped_to_the_same_bytes(drive, tmp_path):
    outputs = RecordedOutputs()
    core = node(outputs, record=tmp_path / "scans.csv")
    drive_all(core, outputs, drive)
    core.close().save(tmp_path / "live")
    map_log(tmp_path / "scans.csv", configuration=FEW, repair="none").save(tmp_path / "replayed")
    for name in ("map.pgm", "map.yaml", "trajectory.tum", "trajectory.csv", "trajectory_online.tum", "graph.g2o"):
        assert (tmp_path / "live" / name).read_bytes() == (tmp_path / "replayed" / name).read_bytes(), name
    assert all(level is Level.OK for level, _ in outputs.logs), outputs.logs


def test_what_it_says_of_a_drive(drive):
    outputs = RecordedOutputs()
    core = node(outputs, transform_publish_period_s=0.01, tf_delay_s=0.3)
    drive_all(core, outputs, drive)
    last = outputs.transforms[-1]
    assert (last.parent, last.child) == ("map", ODOM)
    assert 0 <= last.stamp_ns - drive[-1].scan.stamp_ns - SHIFT_NS - 300_000_000 < 1_000_000  # no two share one
    x, y, _, _, _, sine, cosine = last.pose
    expected = compose([x, y, 2 * np.arctan2(sine, cosine)], drive[-1].odometry.pose)
    np.testing.assert_allclose(outputs.poses[-1].pose, expected, atol=1e-9)
    assert outputs.poses[-1].covariance.shape == (3, 3)
    assert all(0 <= entropy <= np.log(4) + 1e-9 for entropy in outputs.entropies)
    assert len(outputs.entropies) > 3
    assert until(lambda: len(outputs.maps) >= 2)
    assert core.dynamic_map() is outputs.maps[-1]
    told = core.diagnostics()
    assert told.level is Level.OK, told
    assert told.values["accepted"] == str(len(drive))
    assert float(told.values["latency 99 of 100, ms"]) > 0
    core.close()


def test_the_published_map_is_the_one_that_is_written(drive, tmp_path):
    outputs = RecordedOutputs()
    core = node(outputs, configuration=preset("gmapping", 4))
    drive_all(core, outputs, drive)
    assert until(lambda: core._renderer.is_idle)
    assert until(lambda: outputs.maps[-1].stamp_ns == drive[-1].scan.stamp_ns + SHIFT_NS)
    core.save(tmp_path / "out")
    written = read_map(tmp_path / "out" / "map.yaml")
    np.testing.assert_array_equal(map_cells(written), outputs.maps[-1].cells)
    np.testing.assert_allclose(outputs.maps[-1].origin, written.origin)
    core.close()


def test_a_slow_subscriber_of_the_map_does_not_hold_the_filter_up(drive):
    outputs = RecordedOutputs()
    outputs.hold = threading.Event()
    core = node(outputs)
    drive_all(core, outputs, drive)
    assert len(outputs.maps) == 1
    outputs.hold.set()
    core.close()


def test_reset_begins_anew(drive, tmp_path):
    outputs = RecordedOutputs()
    core = node(outputs, record=tmp_path / "scans.csv")
    with pytest.raises(GridslamError, match=r"^nothing is mapped: there was no scan yet$"):
        core.save(tmp_path / "nothing")
    drive_all(core, outputs, drive[:60])
    core.reset()
    assert until(lambda: core.dynamic_map() is None)
    drive_all(core, outputs, drive[60:])
    np.testing.assert_array_equal(outputs.poses[60].pose, np.zeros(3))
    taken = core.close()
    assert taken.log.scan_count == len(drive) - 60
    assert len((tmp_path / "scans.csv").read_text().splitlines()) == 61
    assert taken.record == tmp_path / "scans-2.csv"
    assert (Level.OK, "starting a new map: reset") in outputs.logs, "it was asked for: no warning"


def test_a_log_that_is_played_twice_gives_the_same_map_twice(drive):
    outputs = RecordedOutputs()
    core = node(outputs)
    drive_all(core, outputs, drive)
    play(core, outputs, drive, shift_ns=SHIFT_NS)
    assert until(lambda: len(outputs.poses) >= 2 * len(drive) - 2)
    assert core.diagnostics().values["session"] == "2"
    assert "time jumped back" in outputs.warnings()
    np.testing.assert_array_equal(outputs.poses[len(drive)].pose, np.zeros(3))
    core.close()


def test_when_it_is_behind_the_newest_scans_win(drive):
    outputs = RecordedOutputs()
    core = node(outputs, queue_scans=3)
    for one in drive:
        core.on_transforms([odometry_message(one, SHIFT_NS)])
    gate = threading.Event()
    core._queue.post(lambda: gate.wait(10) and None)
    for one in drive:
        core.on_scan(scan_message(one, SHIFT_NS), "/scan")
    gate.set()
    assert until(lambda: len(outputs.poses) == 3)
    assert [pose.stamp_ns - SHIFT_NS for pose in outputs.poses] == [one.scan.stamp_ns for one in drive[-3:]]
    assert core.diagnostics().values["dropped"] == str(len(drive) - 3)
    core.close()


def test_it_lives_on_after_whatever_is_wrong(drive):
    outputs = RecordedOutputs()
    core = node(outputs, transform_wait_s=0.02)
    core.refuse_message("message", "expected sensor_msgs/LaserScan on /scan, got std_msgs/String")
    core.on_scan(scan_message(drive[0], SHIFT_NS, ranges=np.ones(3, np.float32)), "/scan")
    core.on_scan(scan_message(drive[0], SHIFT_NS, ranges=np.ones(26_214_400, np.float32)), "/scan")
    core.on_scan(scan_message(drive[0], SHIFT_NS, stamp_ns=-1), "/scan")
    core.on_scan(scan_message(drive[0], SHIFT_NS, frame="elsewhere"), "/scan")
    assert until(lambda: "missing transform" in outputs.warnings())
    drive_all(core, outputs, drive[:10])
    assert not core.ended.is_set()
    assert core.diagnostics().values["refused"] == "4"
    core.close()
    assert core.failure is None


def test_a_filter_that_needs_odometry_is_not_run_without():
    with pytest.raises(ConfigurationError, match="odometry: expected needed"):
        NodeCore(NodeSettings(odometry="none"), preset("gmapping"), RecordedOutputs())


def test_an_observer_that_fails_is_reported_and_the_map_goes_on(drive):
    outputs = RecordedOutputs()

    def fails(report, state, seconds):
        raise RuntimeError("no more")

    core = NodeCore(NodeSettings(queue_s=60.0), FEW, outputs, observers=[fails])
    core.on_transforms([mounting()], static=True)
    core.start()
    drive_all(core, outputs, drive[:20])
    assert core.close().log.scan_count == 20
    assert core.failure is None
    assert "viewer failed: RuntimeError: no more (test_node_core.py, line" in outputs.warnings()


def test_a_scan_that_fails_is_left_out_and_the_rest_is_saved(drive, tmp_path, monkeypatch):
    """As an exception inside the filter: the state is consumed, and nothing could be saved."""
    from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping

    outputs = RecordedOutputs()
    core = node(outputs, record=tmp_path / "scans.csv")
    drive_all(core, outputs, drive[:60])
    real = OccupancyGridMapping.__call__

    def fail(self, maps, poses, beams):
        real(self, maps, poses, beams)
        raise MemoryError

    with monkeypatch.context() as patched:
        patched.setattr(OccupancyGridMapping, "__call__", fail)
        play(core, outputs, drive[60:90], shift_ns=SHIFT_NS)
        assert until(lambda: core._queue.counts.accepted == 90)
        document = core.save(tmp_path / "saved")  # while every key scan fails
    assert document["failures"]
    play(core, outputs, drive[90:], shift_ns=SHIFT_NS)
    assert until(lambda: core._queue.counts.accepted == len(drive))
    session = core.close()
    document = session.save(tmp_path / "out")
    assert core.failure is None
    assert "failed and left out: /scan, scan at 1700000" in document["failures"][0]
    assert "scan failed: /scan, scan at" in outputs.warnings()
    scans = len((tmp_path / "out" / "trajectory.tum").read_text().splitlines())
    assert 60 < scans < len(drive)
    assert document["scans"]["read"] == len(drive)


def test_a_robot_that_is_carried_is_reported(drive):
    outputs = RecordedOutputs()
    core = node(outputs)
    drive_all(core, outputs, carry(drive[:40], drive[80:]))
    assert outputs.warnings().count("robot_carried") == 1
    assert "the view changes while the odometry is continuous" in core.diagnostics().summary
    assert core.diagnostics().values["robot_carried, times"] == "1"
    core.close()
