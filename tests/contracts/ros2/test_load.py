"""Much at once, for long, and from the first moment on: no scan is lost."""

import itertools
import os
import signal
import threading
import time

import pytest
from nav_msgs.msg import Odometry
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from support.ros2_peer import Robot, scan, stamped, transform, values
from support.ros_node import odometry_message

STOPS_HZ = 5.0


@pytest.fixture
def robot(domain):
    robot = Robot(domain)
    yield robot
    robot.close()


def cpu_s(process):
    with open(f"/proc/{process.pid}/stat", encoding="ascii") as stat:
        fields = stat.read().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def check(robot, node, sent, record_property, spare=0):
    """Check that all scans are mapped, but for those that are older than the first transform."""
    mapped = robot.tells("accepted", sent - spare)
    told = values(robot.status[-1])
    for name in ("received", "accepted", "latency median, ms", "latency 99 of 100, ms", "latency longest, ms"):
        record_property(name, told[name])
    record_property("CPU, s", cpu_s(node.process))
    assert mapped, (told, node.log.read_text())
    assert told["dropped"] == "0"


@pytest.mark.parametrize("clock_hz", [0, 500])
def test_transforms_at_200_hz_and_scans_at_40_hz(start, robot, drive, clock_hz, record_property):
    node = start(*(("-p", "use_sim_time:=true") if clock_hz else ()))
    assert robot.meets()
    sent = load(robot, drive[:1], 8.0, clock_hz)
    check(robot, node, sent, record_property)


def test_no_scan_is_lost_where_the_machine_pauses_the_node(start, robot, drive):
    """The 80 scans of the pause come at once; of 200, and beside other tests of 160, some are lost on the way."""
    node = start()
    assert robot.meets()
    for after_s, number in ((0.5, signal.SIGSTOP), (1.3, signal.SIGCONT)):
        threading.Timer(after_s, node.process.send_signal, [number]).start()
    robot.drive(itertools.islice(itertools.cycle([*drive, *reversed(drive)]), 200), rate_hz=100.0)
    assert robot.tells("accepted", 199), (values(robot.status[-1]), node.log.read_text())
    assert values(robot.status[-1])["dropped"] == "0"


@pytest.mark.long
def test_half_an_hour_at_40_hz(start, robot, drive, record_property):
    seconds = float(os.environ.get("GRIDSLAM_ROS2_SECONDS", "1800"))
    node = start()
    assert robot.meets()
    memory = []

    def note(sent):
        if sent % 400 == 1:
            memory.append(memory_mb(node.process))
            robot.links.clear()

    sent = load(robot, [*drive, *reversed(drive)], seconds, 0, note)
    record_property("memory, MB, a value every 10 s", [round(one) for one in memory])
    check(robot, node, sent, record_property)
    assert memory[-1] - memory[len(memory) // 10] < 60  # scans are stored, 32 MB at most, and key scans whole


def memory_mb(process):
    with open(f"/proc/{process.pid}/status", encoding="ascii") as status:
        return next(int(line.split()[1]) for line in status if line.startswith("VmRSS")) / 1024


def load(robot, measurements, seconds, clock_hz, on_scan=lambda sent: None):
    """Send what a robot sends that stands at each place of a drive for 0.2 s; returns the number of scans.

    The wheels begin before the laser, as no scan can be placed that is older than any transform.

    Where the machine has paused this process the rest is sent later: no laser makes up for scans that it has missed.
    """
    rates = {"transform": 200.0, "scan": 40.0, **({"clock": float(clock_hz)} if clock_hz else {})}
    begin = time.monotonic()
    due, sent = {kind: begin + 0.1 * (kind == "scan") for kind in rates}, 0
    offset_ns = time.time_ns() - int(begin * 1e9)
    made = [(scan(one, 0), odometry_message(one)) for one in measurements]

    def at(when):
        return made[int(max(0.0, when - begin) * STOPS_HZ) % len(made)]

    while sent < seconds * rates["scan"]:
        now = time.monotonic()
        if now > min(due.values()) + 0.2:
            due = dict.fromkeys(rates, now)
        for kind in [kind for kind, then in due.items() if then <= now]:
            at_ns = int(due[kind] * 1e9) + offset_ns
            if kind == "transform":
                robot.moving.publish(transform(at(due[kind])[1]._replace(stamp_ns=at_ns)))
            elif kind == "clock":
                robot.tell_time(at_ns)
            else:
                message, _ = at(due[kind] - 0.02)
                stamped(message.header.stamp, at_ns - 20_000_000)
                robot.scans.publish(message)
                sent += 1
                on_scan(sent)
            due[kind] += 1 / rates[kind]
        time.sleep(max(0.0, min(due.values()) - time.monotonic()))
    return sent


@pytest.mark.parametrize("rate", [pytest.param(1.0, marks=pytest.mark.long), 3.0])
def test_a_bag_of_a_turtlebot_is_mapped_scan_by_scan(start, domain, data_dir, rate, record_property):
    node, peer = start("-p", "use_sim_time:=true"), Robot(domain, fixed=False)
    try:
        sent = play(peer, data_dir / "bags" / "turtlebot4_floor", rate)
        check(peer, node, sent, record_property, spare=1)
        assert peer.links_of("map")
    finally:
        peer.close()


def play(robot, bag, rate):
    """Play a bag as `ros2 bag play --clock` does; returns the number of scans."""
    odometry = robot.node.create_publisher(Odometry, "/odom", 50)
    publishers = {"/scan": robot.scans, "/odom": odometry, "/tf": robot.moving, "/tf_static": robot.fixed}
    assert robot.meets()
    sent = 0
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        messages = (
            (one.topic, at_ns, bytes(data)) for one, at_ns, data in reader.messages() if one.topic in publishers
        )
        first = next(messages)
        begin, told_ns = time.monotonic(), 0
        for topic, at_ns, data in itertools.chain([first], messages):
            time.sleep(max(0.0, begin + (at_ns - first[1]) * 1e-9 / rate - time.monotonic()))
            if at_ns - told_ns > 5_000_000:
                robot.tell_time(at_ns)
                told_ns = at_ns
            publishers[topic].publish(data)
            sent += topic == "/scan"
    return sent


def test_a_node_maps_though_the_static_transform_is_old(start, robot, drive):
    """It is latched, and was published before the node began: a node that subscribes to news alone never maps."""
    assert robot.stands_until_mapped(drive[0], start())
