"""The checks of ROS 2: the node beside programs of rclpy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from support.ros2_process import Node, free_domain

rclpy = pytest.importorskip("rclpy", reason="no ROS 2 here: .ci/ros2 makes one and runs these tests")

QUICK = "-p", "particles:=4", "-p", "map_update_interval:=0.3"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let what rclpy imports use what is deprecated."""
    for item in items:
        if "ros2" in item.path.parts:
            item.add_marker(pytest.mark.filterwarnings("ignore::DeprecationWarning"))


@pytest.fixture(scope="package")
def drive() -> list[Measurement]:
    rng = np.random.default_rng(1)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90, rate_hz=5), rng)
    return list(log.measurements)[:240]


@pytest.fixture
def domain() -> int:
    return free_domain()


@pytest.fixture
def start(domain: int, tmp_path: Path) -> Iterator[Callable[..., Node]]:
    """Start nodes, which end with the test."""
    nodes: list[Node] = []

    def begin(*arguments: str, options: tuple[str, ...] = (), domain: int = domain) -> Node:
        log = tmp_path / f"{len(nodes)}.log"
        given = *options, "--ros-args", *QUICK, *arguments
        nodes.append(Node(domain, log, *given))
        assert nodes[-1].says("waiting for "), log.read_text()
        return nodes[-1]

    yield begin
    for node in nodes:
        node.kill()
