"""The node in a real ROS 1: bags are played into it by rosbag, and programs of ROS say what they see of it."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
import xmlrpc.client
from pathlib import Path

import numpy as np
import pytest

from gridslam.api.conversion import convert_log
from gridslam.api.mapping import map_log
from gridslam.config import Configuration
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.log import LogOptions, open_log
from gridslam.io.maps import write_map
from support.localization_world import drive as flat_drive
from support.localization_world import flat_map
from support.ports import free_port

SYSTEM_PYTHON, PACKAGES = "/usr/bin/python3", "/usr/lib/python3/dist-packages"
SUPPORT = Path(__file__).resolve().parents[1] / "support"
ROS_PACKAGES = SUPPORT.parents[1] / "ros"
PATIENT = "_transform_wait:=10.0", "_queue:=60.0"  # on a busy machine nothing is dropped
NAME = "/slam_gmapping"
LINKS = ("map:odom", "odom:base_link", "map:base_link")
NODE = f"""
import sys
sys.path.append({PACKAGES!r})  # behind this environment's own packages: rospy is plain Python
from gridslam.cli.main import main
sys.exit(main(["ros1", *sys.argv[1:]]))
"""


def lacking() -> str:
    """What is not installed of ROS 1; empty where all is."""
    tools = ("roscore", "rosbag", "rostopic", "rosservice")
    missing = [name for name in tools if not Path("/usr/bin", name).exists()]
    imports = "import rospy, tf2_ros, nav_msgs.srv, std_srvs.srv, diagnostic_msgs.msg, tf2_msgs.msg, sensor_msgs.msg"
    if not missing and subprocess.run([SYSTEM_PYTHON, "-c", imports], capture_output=True).returncode:
        missing = [f"what this needs: {imports}"]
    return ", ".join(missing)


pytestmark = pytest.mark.skipif(bool(lacking()), reason=f"ROS 1 (Debian's packages) is not installed: {lacking()}")


class Ros:
    """A master of its own, on a free port, with the time of what is played."""

    def __init__(self, folder: Path) -> None:
        port = free_port()
        self.folder, self.uri = folder, f"http://127.0.0.1:{port}"
        kept = {name: value for name, value in os.environ.items() if not name.startswith(("ROS", "PYTHON"))}
        self.environment = {
            **kept,
            "ROS_MASTER_URI": self.uri,
            "ROS_HOSTNAME": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder),
        }
        self.processes: list[subprocess.Popen[str]] = []
        self.port = port
        self.master = xmlrpc.client.ServerProxy(self.uri)
        self.start_master()

    def start_master(self) -> subprocess.Popen[str]:
        core = self.start(["roscore", "-p", str(self.port)], "roscore")
        assert self.until(lambda: bool(self.master.setParam("/test", "/use_sim_time", True)))
        assert self.until(lambda: "/rosout" in str(self.master.getSystemState("/test")))
        return core

    def start(self, command: list[str], log: str) -> subprocess.Popen[str]:
        with (self.folder / f"{log}.log").open("w") as out:
            process = subprocess.Popen(
                command,
                env=self.environment,
                stdout=out,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
            )
        self.processes.append(process)
        return process

    def node(self, *arguments: str, log: str = "node") -> subprocess.Popen[str]:
        process = self.start([sys.executable, "-c", NODE, *arguments], log)
        assert self.until(lambda: self.listens(process.pid)), self.log(log)
        return process

    def listens(self, process: int) -> bool:
        """Whether that process is the node, and listens: the master still knows one that was killed, too."""
        found, _, address = self.master.lookupNode("/test", NAME)
        if found != 1:
            return False
        with xmlrpc.client.ServerProxy(address) as node:
            topics = {name for name, _ in node.getSubscriptions("/test")[2]} - {"/tf", "/tf_static", "/clock"}
            return bool(node.getPid("/test")[2] == process and topics)  # scans are the last that it subscribes to

    def play(self, bag: Path, rate: float, *options: str) -> dict:
        """Play a bag, and give what an independent program has seen of it in the end."""
        ended = self.folder / "ended"
        ended.unlink(missing_ok=True)
        watcher = self.start([SYSTEM_PYTHON, str(SUPPORT / "ros1_watcher.py"), str(ended), NAME, *LINKS], "watcher")
        assert self.until(lambda: "listening" in self.log("watcher")), self.log("watcher")
        self.run("rosbag", "play", "--clock", "--quiet", "--delay=2", "-r", str(rate), *options, str(bag))
        ended.touch()
        assert watcher.wait(120) == 0, self.log("watcher")
        return json.loads(self.log("watcher").splitlines()[-1])

    def run(self, *command: str) -> str:
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=240)
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}\n{self.log('node')}"
        return done.stdout

    def log(self, name: str) -> str:
        return (self.folder / f"{name}.log").read_text()

    def until(self, true, seconds: float = 60.0) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            try:
                if true():
                    return True
            except OSError:
                pass
            time.sleep(0.1)
        return False

    def close(self) -> None:
        self.master("close")()
        for process in reversed(self.processes):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(20)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()


@pytest.fixture
def ros(tmp_path):
    found = Ros(tmp_path)
    yield found
    found.close()


def pose(link: list[float]) -> np.ndarray:
    x, y, sine, cosine = link
    return np.array([x, y, 2 * math.atan2(sine, cosine)])


def test_a_robot_s_bag_is_mapped_as_it_is_offline(ros, data_dir, tmp_path):
    bag, record, out = tmp_path / "robot.bag", tmp_path / "scans.csv", tmp_path / "out"
    others = "topic != '/tf' or m.transforms[0].header.frame_id != 'map'"  # its own map to odom is in the bag, too
    ros.run("rosbag", "filter", str(data_dir / "bags" / "p3dx_trace0.bag"), str(bag), others)
    node = ros.node(
        "scan:=base_scan",
        "_preset:=default",
        "_particles:=8",
        "_xmin:=-10.0",
        f"_record:={record}",
        f"_out:={out}",
        "_map_update_interval:=0.5",
        *PATIENT,
    )
    assert "ignored parameters: xmin (the map grows by itself)" in ros.log("node")
    seen = ros.play(bag, 3, "-u", "20")
    assert "redundant timestamp for frame odom " not in ros.log("watcher")  # what tf2 says of two with one stamp
    assert "missing transform" not in ros.log("node")  # at the beginning and the end of the bag
    grid = seen["map"]
    assert grid == seen["dynamic_map"]
    assert (grid["frame"], round(grid["resolution"], 6), grid["origin"][2]) == ("map", 0.05, 1.0)
    assert grid["cells"] == grid["width"] * grid["height"]
    assert seen["metadata_width"] == grid["width"]
    assert set(grid["counts"]) == {"-1", "0", "100"}
    assert grid["counts"]["100"] > 300
    assert grid["counts"]["0"] > 5000
    values = seen["diagnostics"]["values"]
    assert int(values["accepted"]) >= 190
    assert values["dropped"] == "0"
    assert "OccupancyGrid" in ros.run("rostopic", "type", "/map")
    assert 'frame_id: "map"' in ros.run("rostopic", "echo", "-n", "1", "/map/header")
    assert "success: True" in ros.run("rosservice", "call", "/slam_gmapping/save")
    node.send_signal(signal.SIGINT)
    assert node.wait(60) == 0, ros.log("node")
    replayed = map_log(record, configuration=Configuration(particles=8), repair="none")
    replayed.save(tmp_path / "replayed")
    begun = replayed.trajectory.stamps_ns[0] - next(iter(open_log(bag))).scan.stamp_ns  # the first scans may be missed
    part = LogOptions(start_s=max(begun * 1e-9 - 0.01, 0.0), duration_s=20.0 - begun * 1e-9)
    offline = map_log(bag, particles=8, options=part, repair="none")
    difference = pose(seen["map:base_link"]) - offline.online_trajectory.poses[-1]
    assert np.abs(difference).max() < 0.15, (seen, offline.online_trajectory.poses[-1])
    for name in ("map.pgm", "trajectory.tum", "trajectory_online.tum", "graph.g2o"):
        assert (out / name).read_bytes() == (tmp_path / "replayed" / name).read_bytes(), name


def test_a_converted_log_is_played_twice_and_the_services_serve(ros, data_dir, tmp_path):
    bag = tmp_path / "intel.bag"
    convert_log(data_dir / "intel.clf.bz2", bag, options=LogOptions(duration_s=60.0))
    old = "_map_frame:=/map", "_odom_frame:=/odom"  # as before tf2, whose listeners refuse the slash
    ros.node("scan:=scan", "_particles:=5", "_linearUpdate:=0.5", "_map_update_interval:=0.3", *old, *PATIENT)
    assert (
        "ERROR"
        in subprocess.run(
            ["rosservice", "call", "/dynamic_map"], env=ros.environment, capture_output=True, text=True, timeout=120
        ).stderr
    )
    first = ros.play(bag, 15)
    assert first["diagnostics"]["values"]["session"] == "1"
    assert first["map"]["counts"]["0"] > 1000
    assert first["map"]["frame"] == "map"
    assert 0 <= first["entropy"] <= math.log(5) + 1e-9
    second = ros.play(bag, 15)
    assert second["diagnostics"]["values"]["session"] == "2"
    assert "time jumped back" in ros.log("node")
    apart = pose(first["map:odom"]) - pose(second["map:odom"])
    assert np.abs(apart).max() < 0.5
    assert "paused" in ros.run("rosservice", "call", "/slam_gmapping/pause", "true")
    ros.run("rosservice", "call", "/slam_gmapping/reset")
    assert ros.until(lambda: "starting a new map: reset" in ros.log("node"))


def test_a_node_that_was_killed_is_started_again(ros, data_dir, tmp_path):
    """Who waited for the first node's map gets the second one's, and who comes late, too."""
    bag = tmp_path / "intel.bag"
    convert_log(data_dir / "intel.clf.bz2", bag, options=LogOptions(duration_s=60.0))
    few = "scan:=scan", "_particles:=4", "_linearUpdate:=0.5", "_map_update_interval:=0.3"
    node = ros.node(*few, *PATIENT)
    ros.start(["rostopic", "echo", "/map/header"], "maps")
    first = ros.play(bag, 15)
    node.kill()
    node.wait(20)
    maps = ros.log("maps").count("frame_id")
    assert maps > 0
    second = ros.node(*few, *PATIENT, f"_out:={tmp_path / 'out'}", log="second")
    again = ros.play(bag, 15)
    assert ros.until(lambda: ros.log("maps").count("frame_id") > maps)
    assert [seen["diagnostics"]["values"]["session"] for seen in (first, again)] == ["1", "1"]
    assert again["map"]["counts"]["0"] > 1000
    assert again["map"] == again["dynamic_map"]
    second.send_signal(signal.SIGTERM)
    assert second.wait(60) == 0, ros.log("second")
    assert " scans to " in ros.log("second")
    assert (tmp_path / "out" / "map.pgm").is_file()


def test_a_robot_is_localized_in_a_known_map(ros, tmp_path):
    """As with map_server and AMCL: the map is there at once, and the robot is placed by parameters of AMCL's names."""
    log = flat_drive(3)
    write_map(tmp_path / "flat.yaml", flat_map())
    write_carmen(tmp_path / "flat.clf", log.measurements[:60])
    convert_log(tmp_path / "flat.clf", tmp_path / "flat.bag")
    start = [f"_initial_pose_{name}:={value}" for name, value in zip("xya", log.truth.poses[0].tolist(), strict=True)]
    node = ros.node("scan:=scan", "--map", str(tmp_path / "flat.yaml"), *start, "_do_beamskip:=true", *PATIENT)
    assert "do_beamskip (it has no equivalent)" in ros.log("node")
    ros.start(["rostopic", "echo", "/particlecloud/header/frame_id"], "cloud")
    seen = ros.play(tmp_path / "flat.bag", 3)
    told, truth = pose(seen["map:base_link"]), log.truth.poses[59]
    assert np.hypot(*(told - truth)[:2]) < 0.4, (told, truth, ros.log("node"))
    assert seen["map"]["resolution"] == pytest.approx(0.05)
    assert ros.until(lambda: '"map"' in ros.log("cloud"))
    kind = "geometry_msgs/PoseWithCovarianceStamped"
    ros.start(["rostopic", "pub", "-1", "/initialpose", kind, "{header: {frame_id: odom}}"], "publisher")
    assert ros.until(lambda: "initialpose: expected a pose in the frame map, got 'odom'" in ros.log("node"))
    assert "geometry_msgs/PoseWithCovarianceStamped" in ros.run("rostopic", "type", "/amcl_pose")
    assert "frame_id" in ros.run("rostopic", "echo", "-n", "1", "/amcl_pose/header")  # latched
    ros.run("rosservice", "call", "/global_localization")
    node.send_signal(signal.SIGINT)
    assert node.wait(60) == 0, ros.log("node")


def install_packages(ros, tmp_path):
    program = tmp_path / "gridslam"
    script = NODE.replace('"ros1", *', "*")  # the script of the package says ros1
    program.write_text(f"#!{sys.executable}\n{script}")
    program.chmod(0o755)
    ros.environment |= {"ROS_PACKAGE_PATH": str(ROS_PACKAGES), "GRIDSLAM": str(program)}


def test_roslaunch_starts_the_node_of_the_package(ros, tmp_path):
    install_packages(ros, tmp_path)
    arguments = ["scan:=base_scan", "particles:=4", f"out:={tmp_path / 'out'}"]
    launch = ros.start(["roslaunch", "gmapping", "gridslam.launch", *arguments], "node")
    assert ros.until(lambda: "/base_scan" in str(ros.master.getSystemState("/test")[2][1])), ros.log("node")
    assert ros.master.getParam("/test", "/slam_gmapping/particles")[2] == 4
    launch.send_signal(signal.SIGINT)
    assert launch.wait(60) == 0, ros.log("node")


LAUNCH = """
<launch>
  <arg name="base" default="base_footprint"/>
  <node pkg="gmapping" type="slam_gmapping" name="robot_slam_gmapping" output="screen">
    <param name="base_frame" value="$(arg base)"/>
    <param name="map_update_interval" value="2.0"/>
    <param name="maxUrange" value="3.0"/>
    <param name="minimumScore" value="50"/>
    <param name="lskip" value="0"/>
    <param name="temporalUpdate" value="0.5"/>
    <param name="particles" value="10"/>
    <param name="xmin" value="-10.0"/>
    <param name="llsamplerange" value="0.01"/>
  </node>
</launch>
"""


def test_a_robot_s_own_launch_file_for_gmapping_starts_it_unchanged(ros, tmp_path):
    install_packages(ros, tmp_path)
    (tmp_path / "robot.launch").write_text(LAUNCH)
    launch = ros.start(["roslaunch", str(tmp_path / "robot.launch")], "node")
    assert ros.until(lambda: "base_footprint in odom" in ros.log("node")), ros.log("node")
    assert "ignored parameters: " in ros.log("node")
    assert "there is no such parameter" not in ros.log("node")
    launch.send_signal(signal.SIGINT)
    assert launch.wait(60) == 0, ros.log("node")
