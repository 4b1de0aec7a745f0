"""The node on the wire of ROS 2, and a program on another vendor's DDS: scans in, the latched map out."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="Cyclone DDS (the extra ros2) is not installed")

from support.dds_peer import Node, free_domain

PEER = Path(__file__).resolve().parents[1] / "support" / "fastdds_peer.cpp"


@pytest.fixture(scope="module")
def peer(tmp_path_factory):
    """The program, compiled."""
    header = Path("/usr/include/fastdds/dds/domain/DomainParticipant.hpp")
    if not header.exists() or shutil.which("g++") is None:
        pytest.skip("Fast DDS is not installed (Debian: libfastrtps-dev, libfastcdr-dev and g++)")
    program = tmp_path_factory.mktemp("peer") / "peer"
    command = ["g++", "-std=c++17", "-O1", str(PEER), "-o", str(program), "-lfastrtps", "-lfastcdr"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr[-2000:]
    return program


def test_another_vendor_s_program_is_understood_and_understands(peer, tmp_path):
    domain = free_domain()
    (tmp_path / "robot.yaml").write_text("/**:\n  ros__parameters:\n    particles: 4\n    map_update_interval: 0.3\n")
    parameters = "--ros-args", "--params-file", str(tmp_path / "robot.yaml")
    node = Node(domain, tmp_path / "node.log", *parameters, interface="")  # by ROS_LOCALHOST_ONLY
    try:
        done = subprocess.run([str(peer), str(domain), "80"], capture_output=True, text=True, timeout=400)
        assert done.returncode == 0, done.stderr + node.log.read_text()
        assert node.end() == 0, node.log.read_text()
    finally:
        node.kill()
    found = json.loads(done.stdout)
    grid = found["map"]
    assert found["links"] >= 30
    assert (grid["frame"], grid["resolution"], grid["origin"][2]) == ("map", 0.05, 1.0)
    assert grid["cells"] == grid["width"] * grid["height"]
    assert grid["unknown"] + grid["free"] + grid["occupied"] == grid["cells"]
    # The room has 24000 cells, of which a scan sees 270 degrees; each metre of its 32 m of wall has 20 cells.
    assert 4_000 < grid["free"] < 24_000
    assert 100 < grid["occupied"] < 1200
