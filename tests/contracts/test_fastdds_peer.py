"""The node on the wire of ROS 2, and a program on another vendor's DDS: scans in, the latched map out."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="Cyclone DDS (the extra ros2) is not installed")
ROOT = Path(__file__).resolve().parents[2]
PEER = ROOT / "tests" / "support" / "fastdds_peer.cpp"
NODE = """
import sys
from gridslam.cli.interrupt import handled_signals
from gridslam.cli.ros import ros2
with handled_signals():
    ros2(sys.argv[1:], transport="dds", interfaces=["127.0.0.1"])
"""


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    """The program, compiled."""
    header = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
    if not header.exists() or shutil.which("g++") is None:
        pytest.skip("Fast DDS is not installed (Debian: libfastrtps-dev, libfastcdr-dev and g++)")
    program = tmp_path_factory.mktemp("peer") / "peer"
    command = ["g++", "-std=c++17", "-O1", str(PEER), "-o", str(program), "-lfastrtps", "-lfastcdr"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return program


def test_another_vendor_s_program_is_understood_and_understands(peer, tmp_path):
    domain = 120 + os.getpid() % 80
    others = "ROS", "CYCLONE", "FASTRTPS"
    environment = {name: value for name, value in os.environ.items() if not name.startswith(others)}
    environment["ROS_DOMAIN_ID"] = str(domain)
    arguments = ["-p", "particles:=4", "-p", "map_update_interval:=0.3"]
    with (tmp_path / "node.log").open("w") as log:
        node = subprocess.Popen([sys.executable, "-c", NODE, *arguments], env=environment, stderr=log)
    try:
        time.sleep(1)
        done = subprocess.run([str(peer), str(domain), "80"], capture_output=True, text=True, timeout=60)
        assert done.returncode == 0, done.stderr + (tmp_path / "node.log").read_text()
    finally:
        node.send_signal(signal.SIGINT)
        assert node.wait(20) == 0, (tmp_path / "node.log").read_text()
    found = json.loads(done.stdout)
    grid = found["map"]
    assert found["links"] >= 30  # of 80 scans those before the first heartbeat may be lost; and 20 a second
    assert (grid["frame"], grid["resolution"], grid["origin"][2]) == ("map", 0.05, 1.0)
    assert grid["cells"] == grid["width"] * grid["height"]
    assert grid["unknown"] + grid["free"] + grid["occupied"] == grid["cells"]
    # The room has 24000 cells, of which a scan sees 270 degrees; each metre of its 32 m of wall has 20 cells.
    assert 4_000 < grid["free"] < 24_000
    assert 100 < grid["occupied"] < 1200
