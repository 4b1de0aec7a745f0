"""The published transforms: of one stamp tf2 keeps the first and warns of the others, so no two may share one."""

import time

import numpy as np
import pytest

from gridslam.config import preset
from gridslam.ros import NodeCore, NodeSettings
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.ros_node import RecordedOutputs, mounting, odometry_message, play, scan_message, until

SHIFT_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def drive():
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return list(log.measurements)[:60]


def start(outputs, **settings):
    core = NodeCore(NodeSettings(**settings), preset("default", 4), outputs)
    core.on_transforms([mounting()], static=True)
    core.start()
    return core


def test_under_a_simulated_clock_each_transform_has_its_own_stamp(drive):
    """The clock moves with the scans only, and the timer publishes in between."""
    outputs = RecordedOutputs()
    core = start(outputs, transform_publish_period_s=0.002)
    play(core, outputs, drive, shift_ns=SHIFT_NS)
    assert until(lambda: len(outputs.poses) == len(drive))
    time.sleep(0.3)  # a clock at rest
    core.close()
    stamps = np.array([one.stamp_ns for one in outputs.transforms])
    assert len(stamps) > len(drive)
    assert (np.diff(stamps * 1e-9) > 0).all()  # in floats, too, as tf2 has them in Python
    ahead_ns = stamps[-1] - SHIFT_NS - drive[-1].scan.stamp_ns
    assert 0 <= ahead_ns - 50_000_000 < 1_000_000


def test_a_scan_between_two_readings_of_the_odometry_does_not_wait_for_the_next(drive):
    """At 10 Hz, anywhere between two readings: its pose comes while there is no next one."""
    rng, outputs = np.random.default_rng(0), RecordedOutputs()
    core = start(outputs)
    for k, one in enumerate(drive[:20]):
        shift_ns = SHIFT_NS + k * 100_000_000 - one.scan.stamp_ns
        core.on_transforms([odometry_message(one, shift_ns)])
        scan = scan_message(one, shift_ns + int(rng.integers(5, 95)) * 1_000_000)
        core.on_scan(scan, "/scan")
        # The first waits for a second reading, as there is no velocity.
        assert k == 0 or until(lambda scan=scan: scan.stamp_ns in {pose.stamp_ns for pose in outputs.poses})
    core.close()
    assert int(core.diagnostics().values["extrapolated"]) >= 15
