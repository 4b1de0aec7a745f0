"""Libraries that only loop closure needs are imported at the first scan of those who close loops, and never later."""

import subprocess
import sys

import pytest

DRIVE = """
import sys
from dataclasses import replace
import numpy as np
from gridslam import Configuration, build
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

def of_libraries():
    return {name for name in sys.modules if name.partition(".")[0] in ("scipy", "qdldl")}

rng = np.random.default_rng(0)
drive = iter(simulate(make_world("demo", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng).measurements)
configuration = Configuration()
if sys.argv[1] == "filter":
    configuration = replace(configuration, loop_closure=None)
slam = build(configuration)
assert not of_libraries(), of_libraries()
state, _ = slam.init(*next(drive))
at_first = of_libraries()
for odometry, scan in drive:
    state, _ = slam.step(state, odometry, scan, rng)
closed = state.closure_state is not None and len(state.closure_state.graph.constraints)
print(len(at_first), len(of_libraries() - at_first), closed)
"""


@pytest.mark.parametrize("which", ["filter", "loops"])
def test_no_later_scan_waits_for_an_import(which):
    done = subprocess.run([sys.executable, "-c", DRIVE, which], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    at_first, later, closed = done.stdout.split()
    assert later == "0"
    if which == "filter":
        assert at_first == "0"
    else:
        assert int(closed) > 0  # else nothing would have asked for them
