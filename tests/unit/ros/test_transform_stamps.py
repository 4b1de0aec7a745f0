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


def pose_latencies(drive, seed):
    """Latencies of the poses, s, and the diagnostics: odometry at 10 Hz, scans anywhere between two readings."""
    rng = np.random.default_rng(seed)
    came, latencies = {}, []

    class Timed(RecordedOutputs):
        def pose(self, message):
            latencies.append(time.perf_counter() - came[message.stamp_ns])

        def now_ns(self):
            return time.time_ns()

    core = start(Timed())
    begin, begin_ns = time.perf_counter(), time.time_ns()
    for k, one in enumerate(drive):
        shift_ns = begin_ns + k * 100_000_000 - one.scan.stamp_ns
        time.sleep(max(0.0, begin + 0.1 * k - time.perf_counter()))
        core.on_transforms([odometry_message(one, shift_ns)])
        scan = scan_message(one, shift_ns + int(rng.integers(5, 95)) * 1_000_000)
        time.sleep(max(0.0, begin + (scan.stamp_ns - begin_ns) * 1e-9 - time.perf_counter()))
        came[scan.stamp_ns] = time.perf_counter()
        core.on_scan(scan, "/scan")
    core.close()
    return latencies, core.diagnostics().values


def test_the_pose_at_10_hz_odometry_comes_within_60_ms(drive):
    """The median of waiting for the next reading would be 50 ms, 95 of 100 would wait for 90 ms.

    Once in three times, as the machine may be busy.
    """
    slowest = []
    for seed in range(3):
        latencies, values = pose_latencies(drive[:40], seed)
        assert len(latencies) >= 37  # the first has no velocity, and the last may come after the end
        assert int(values["extrapolated"]) >= 15
        slowest.append(np.quantile(latencies, 0.95))
        if slowest[-1] <= 0.06:
            break
    assert min(slowest) <= 0.06
