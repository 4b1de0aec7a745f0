"""A robot that drives about for hours: memory stays bounded, and a scan costs what it cost at the beginning."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gridslam
from gridslam.evaluation import absolute_errors
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate

LAPS = 100


def resident_mb() -> float:
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmRSS:"))
    return int(line.split()[1]) / 1024


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is read from /proc")
def test_a_hundred_laps(record_property):
    """The suite of rooms, 40 m a lap; everything is seen in the first lap, and again and again."""
    once, rng = make_world("rooms", np.random.default_rng(0)), np.random.default_rng(1)
    lap = once.route[:7]
    world = World.of("laps", once.walls, np.concatenate([*[lap] * LAPS, lap[:1]]))
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    slam, poses, seconds, memory, maps, nodes = gridslam.GridFastSlam(), [], [], [], [], []

    def watch(report, state, took):
        poses.append(report.pose)
        if report.skipped is None:
            seconds.append(took)
        if len(poses) % (len(log) // 10) == 0:
            memory.append(resident_mb())
            maps.append(state.maps.nbytes / 1e6)
            nodes.append(len(state.ancestry.to_arrays()["poses"]))

    gridslam.run(log.measurements, slam, particles=30, rng=rng, observers=[watch])
    tenths = [1e3 * np.median(part) for part in np.array_split(seconds, 10)]
    online = gridslam.Trajectory(log.truth.stamps_ns, np.array(poses))
    errors = absolute_errors(online, log.truth)
    record_property("scans", len(poses))
    record_property("key scan, ms, by tenths", " ".join(f"{t:.2f}" for t in tenths))
    record_property("memory, MB", " ".join(f"{m:.0f}" for m in memory))
    record_property("maps, MB", " ".join(f"{m:.1f}" for m in maps))
    record_property("poses in the ancestry", " ".join(str(n) for n in nodes))
    record_property("ATE", f"{errors.trans_rmse_m:.3f} m rms, {errors.trans_max_m:.3f} m at most")
    # The first tenth sees the rooms for the first time; a noisy machine's medians scatter by a quarter at most.
    assert np.mean(tenths[5:]) < 1.25 * np.mean(tenths[1:5])
    assert max(maps[5:]) < 1.25 * max(maps[:5])
    assert memory[-1] - memory[4] < 20  # what is kept of each scan and key scan: 0.2 kB and 1 kB, and fragmentation
    assert errors.trans_max_m < 0.3
