"""The node on the wire of ROS 2 under load: the command in a process of its own, the robot in this one, on loopback."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gridslam.io.bags.encoder import MessageEncoder
from gridslam.ros.node.messages import GridMessage, Level, ScanMessage, StampedTransform
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.ros2_dds.participant import DdsParticipant
from gridslam.ros.rtps.qos import Qos
from load import LATENCY, MOUNTING, START_S, Load, drive, resident_mb
from measure import GRIDSLAM

__all__ = ["grid_ms", "load_on_dds"]

_DOMAIN = 93
_LOOPBACK = "127.0.0.1"
_PATIENCE_S = 60.0
_ENCODER = MessageEncoder(is_ros1=False)


def load_on_dds(seconds: float, rate_hz: float, beams: int, particles: int) -> Load:
    """Drive before the command; the latency holds the way there and back, and this process's own delays."""
    messages = [(_transforms(link), _scan(scan), scan.stamp_ns) for link, scan in drive(seconds, rate_hz, beams)]
    robot, came_s, told_s = DdsParticipant(_DOMAIN, [_LOOPBACK]), dict[int, float](), dict[int, float]()
    diagnostics: list[bytes] = []
    for topic, kind in (("rt/scan", "sensor_msgs/LaserScan"), ("rt/tf", "tf2_msgs/TFMessage")):
        robot.add_writer(topic, kind)
    robot.add_writer("rt/tf_static", "tf2_msgs/TFMessage", Qos(latched=True, depth=1))

    def told(data: bytes, sender: str) -> None:
        told_s[_stamp_ns(data)] = time.perf_counter()

    robot.add_reader("rt/gridslam/pose", "geometry_msgs/PoseWithCovarianceStamped", told, Qos(depth=1000))
    robot.add_reader("rt/diagnostics", "diagnostic_msgs/DiagnosticArray", lambda data, sender: diagnostics.append(data))
    robot.start()
    robot.publish("rt/tf_static", _transforms(MOUNTING))
    command = [*GRIDSLAM, "ros2", "--transport", "dds", "--interface", _LOOPBACK, "--particles", str(particles)]
    node = subprocess.Popen(command, env={**os.environ, "ROS_DOMAIN_ID": str(_DOMAIN)}, stderr=subprocess.DEVNULL)
    try:
        _wait(lambda: bool(diagnostics))
        time.sleep(START_S)  # until its readers know this writer, too
        memory_mb, cpu_s = _drive(robot, messages, came_s, node.pid)
        time.sleep(2 * START_S)  # what is queued is mapped yet, and told in its diagnostics
        values = _values(diagnostics[-1])
    finally:
        node.send_signal(signal.SIGINT)
        node.wait(_PATIENCE_S)
        robot.close()
    latency = np.array([told_s[stamp] - came_s[stamp] for stamp in sorted(told_s)])
    dropped, refused = int(values["dropped"]), int(values["refused"])
    return Load({LATENCY: latency}, len(messages), dropped, refused, 0, cpu_s, memory_mb)


def _drive(
    robot: DdsParticipant, messages: list[tuple[bytes, bytes, int]], came_s: dict[int, float], process: int
) -> tuple[list[float], float]:
    """Send at the drive's pace; returns the node's memory once a second, MB, and its CPU seconds."""
    memory_mb, due_mb = [resident_mb(process)], 0.0
    before_s, begin_s, begin_ns = _cpu_s(process), time.perf_counter(), time.time_ns()
    for transforms, scan, at_ns in messages:
        due_s, stamp_ns = begin_s + at_ns * 1e-9, begin_ns + at_ns
        time.sleep(max(0.0, due_s - time.perf_counter()))
        robot.publish("rt/tf", _stamped(transforms, stamp_ns, 8))
        came_s[stamp_ns] = time.perf_counter()
        robot.publish("rt/scan", _stamped(scan, stamp_ns, 4))
        if at_ns * 1e-9 > due_mb:
            memory_mb.append(resident_mb(process))
            due_mb += 1.0
    return memory_mb, _cpu_s(process) - before_s


def _transforms(link: StampedTransform) -> bytes:
    header = _ENCODER.header("/tf", link.stamp_ns, link.parent)
    return _ENCODER.encode("tf2_msgs/TFMessage", [(header, link.child, (link.pose[:3], link.pose[3:]))])


def _scan(scan: ScanMessage) -> bytes:
    values = scan.angle_min, 0.0, scan.angle_increment, 0.0, 0.0, scan.range_min, scan.range_max
    header = _ENCODER.header("scan", scan.stamp_ns, scan.frame)
    return _ENCODER.encode("sensor_msgs/LaserScan", header, *values, scan.ranges, [])


def _stamped(data: bytes, stamp_ns: int, at: int) -> bytes:
    """The message with another stamp, which lies `at` these bytes."""
    return data[:at] + struct.pack("<iI", *divmod(stamp_ns, 10**9)) + data[at + 8 :]


def _stamp_ns(data: bytes) -> int:
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    return int(seconds * 10**9 + nanoseconds)


def _values(data: bytes) -> dict[str, str]:
    """Keys and values of the diagnostics."""
    message = _ENCODER.decode("diagnostic_msgs/DiagnosticArray", data)
    return {pair.key: pair.value for pair in message.status[0].values}


def _wait(true: Callable[[], bool]) -> None:
    end = time.monotonic() + _PATIENCE_S
    while not true():
        if time.monotonic() > end:
            raise TimeoutError("the node does not answer")
        time.sleep(0.05)


def _cpu_s(process: int) -> float:
    """CPU seconds of a process, by Linux."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def grid_ms(times: int = 20) -> list[tuple[str, float]]:
    """What a grid of 1000 x 1000 cells costs to publish by DDS, ms: the least of some times."""
    robot = DdsParticipant(_DOMAIN, [_LOOPBACK])
    robot.add_writer("rt/map", "nav_msgs/OccupancyGrid", Qos(latched=True, depth=1))
    robot.add_writer("rt/map_metadata", "nav_msgs/MapMetaData", Qos(latched=True, depth=1))
    got: list[bytes] = []
    cells = np.full((1000, 1000), 100, np.int8)

    def published(topic: str, data: bytes) -> None:
        robot.publish(f"rt/{topic}", data)

    outputs = EncodedOutputs(
        robot.encoder, published, time.time_ns, lambda level, text: print(Level(level), text), "node"
    )
    grid = GridMessage(1, "map", 0.05, (0.0, 0.0), cells)

    def least() -> float:
        begun = []
        for _ in range(times):
            begin = time.perf_counter()
            outputs.map(grid)
            begun.append(time.perf_counter() - begin)
            time.sleep(0.02)
        return 1e3 * min(begun)

    alone = least()
    listener = DdsParticipant(_DOMAIN, [_LOOPBACK])
    listener.add_reader(
        "rt/map", "nav_msgs/OccupancyGrid", lambda data, sender: got.append(data), Qos(latched=True, depth=1)
    )
    robot.start()
    listener.start()
    _wait(lambda: bool(got))
    heard = least()
    robot.close()
    listener.close()
    return [("nobody listens", alone), ("a reader in another participant", heard)]
