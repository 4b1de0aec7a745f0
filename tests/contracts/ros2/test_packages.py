"""The packages of the folder ros are those of ROS: valid for catkin_pkg, and built by colcon."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from support.house import ROOT

catkin_pkg = pytest.importorskip("catkin_pkg.package")


@pytest.mark.parametrize(("name", "kind"), [("gridslam_ros", "ament_python"), ("gmapping", "catkin")])
def test_a_package_is_valid(name, kind):
    warnings: list[str] = []
    package = catkin_pkg.parse_package(ROOT / "ros" / name, warnings=warnings)
    package.validate(warnings=warnings)
    assert (package.name, package.get_build_type(), warnings) == (name, kind, [])


def test_colcon_builds_and_installs_the_package_as_one_of_ros(tmp_path):
    """Where it takes it for plain Python, `ros2 launch` and `ros2 run` do not find it."""
    command = [str(Path(sys.executable).with_name("colcon")), "--log-base", str(tmp_path / "log")]
    at = "--base-paths", str(ROOT / "ros" / "gridslam_ros")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    built = subprocess.run([*command, "build", *at], capture_output=True, text=True, cwd=tmp_path, env=environment)
    assert built.returncode == 0, built.stderr
    share = tmp_path / "install" / "gridslam_ros" / "share"
    assert (share / "ament_index" / "resource_index" / "packages" / "gridslam_ros").is_file()
    assert (share / "gridslam_ros" / "hook" / "ament_prefix_path.sh").is_file()
    launch = {path.name for path in (share / "gridslam_ros" / "launch").iterdir()}
    assert launch == {path.name for path in (ROOT / "ros" / "gridslam_ros" / "launch").glob("*.launch.py")}
    assert (tmp_path / "install" / "gridslam_ros" / "lib" / "gridslam_ros" / "node").is_file()
