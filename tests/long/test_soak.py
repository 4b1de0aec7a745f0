"""A robot that drives about for hours: memory stays bounded, and a scan costs what it cost at the beginning."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import gridslam
from gridslam.evaluation import absolute_errors
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from support.timed import drive

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
    memory, maps, nodes, done = [], [], [], 0

    def look(state):
        nonlocal done
        done += 1
        if done % (len(log) // 10) == 0:
            memory.append(resident_mb())
            maps.append(state.maps.nbytes / 1e6)
            nodes.append(len(state.ancestry.to_arrays()["poses"]))

    _, poses, seconds = drive(log.measurements, rng, look)
    tenths = [1e3 * np.median(part) for part in np.array_split(seconds, 10)]
    errors = absolute_errors(gridslam.Trajectory(log.truth.stamps_ns, poses), log.truth)
    record_property("scans", len(poses))
    record_property("key scan, ms, by tenths", " ".join(f"{t:.2f}" for t in tenths))
    record_property("memory, MB", " ".join(f"{m:.0f}" for m in memory))
    record_property("maps, MB", " ".join(f"{m:.1f}" for m in maps))
    record_property("poses in the ancestry", " ".join(str(n) for n in nodes))
    record_property("ATE", f"{errors.trans_rmse_m:.3f} m rms, {errors.trans_max_m:.3f} m at most")
    # The first tenth sees the rooms for the first time; medians of CPU times scatter by a tenth.
    assert np.mean(tenths[5:]) < 1.25 * np.mean(tenths[1:5])
    assert max(maps[5:]) < 1.25 * max(maps[:5])
    # Twelve thousand scans, six thousand of them key scans: 30 particles' poses and parents until they coalesce, 6 MB.
    assert memory[-1] - memory[4] < 20
    assert errors.trans_max_m < 0.3
