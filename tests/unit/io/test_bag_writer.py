"""What the writer writes rosbags reads: topics, types, stamps, values, and the order of the log."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from gridslam.errors import ArgumentError, OutputError
from gridslam.geometry import se2
from gridslam.io.bags.writer import write_bag
from gridslam.io.measurement import Measurement
from gridslam.types import LaserScan, Odometry, ScanGeometry
from support import se3

S = 1_000_000_000
START = 1_700_000_000 * S
NAMES = ["log.bag", "log.mcap", "log.db3", "log"]
UPSIDE_DOWN = se3.from_quaternion([0.1, 0.02, 0.3], [1, 0, 0, 0])


def scan(stamp_ns=START, beams=90, mounting=UPSIDE_DOWN, ranges=None, seed=0, bearings=None, **told):
    angles = -math.pi / 2 + math.pi / beams * np.arange(beams) if bearings is None else bearings
    values = np.random.default_rng(seed).uniform(0.1, 29, len(angles)) if ranges is None else ranges
    return LaserScan.from_ranges(stamp_ns, values, ScanGeometry(angles, mounting), **({"range_max_m": 30.0} | told))


def log(count=5, step_ns=S // 10, **told):
    for k in range(count):
        stamp_ns = START + k * step_ns
        yield Measurement(Odometry.at(stamp_ns, [0.1 * k, -0.05 * k, 0.02 * k]), scan(stamp_ns, seed=k, **told))


def read(path):
    """Topic, time of recording and message, in the order of recording."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        return [
            (connection.topic, recorded_ns, reader.deserialize(data, connection.msgtype))
            for connection, recorded_ns, data in reader.messages()
        ]


def of_topic(messages, topic):
    return [message for name, _, message in messages if name == topic]


def stamp_of(header):
    return header.stamp.sec * S + header.stamp.nanosec


def matrix_of(transform):
    t, q = transform.translation, transform.rotation
    return se3.from_quaternion([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])


@pytest.mark.parametrize("name", NAMES)
def test_what_is_written_is_read(tmp_path, name):
    written = list(log())
    write_bag(tmp_path / name, iter(written))
    assert [path.name for path in tmp_path.iterdir()] == [name]
    messages = read(tmp_path / name)
    topics = [topic for topic, _, _ in messages]
    assert topics == ["/odom", "/tf", "/tf_static", "/scan", *["/odom", "/tf", "/scan"] * 4]
    assert all(a < b for (_, a, _), (_, b, _) in pairwise(messages))
    assert all(0 <= recorded - START - k // 3 * S // 10 < 10 for k, (_, recorded, _) in enumerate(messages[1:]))

    for back, (_, laser) in zip(of_topic(messages, "/scan"), written, strict=True):
        assert (stamp_of(back.header), back.header.frame_id) == (laser.stamp_ns, "laser")
        bearings = back.angle_min + back.angle_increment * np.arange(90)
        # Single precision: 2^-24 of 90 steps of 2 degrees and of the first angle.
        np.testing.assert_allclose(bearings, laser.geometry.bearings, rtol=0, atol=4e-7)
        assert back.angle_max == pytest.approx(laser.geometry.bearings[-1], abs=1e-6)
        np.testing.assert_array_equal(back.ranges, laser.ranges.astype(np.float32))
        assert (back.range_min, back.range_max, back.time_increment, back.scan_time) == (0, 30, 0, 0)
        assert len(back.intensities) == 0
    for back, moved, (odometry, _) in zip(of_topic(messages, "/odom"), of_topic(messages, "/tf"), written, strict=True):
        (link,) = moved.transforms
        assert (back.header.frame_id, back.child_frame_id) == ("odom", "base_link")
        assert (link.header.frame_id, link.child_frame_id) == ("odom", "base_link")
        assert stamp_of(back.header) == stamp_of(link.header) == odometry.stamp_ns
        assert [back.pose.pose.position.x, back.pose.pose.position.y] == odometry.pose[:2].tolist()
        np.testing.assert_allclose(se3.to_planar(matrix_of(link.transform)), odometry.pose, atol=1e-15)
    ((mounting,),) = (message.transforms for message in of_topic(messages, "/tf_static"))
    assert (mounting.header.frame_id, mounting.child_frame_id) == ("base_link", "laser")
    np.testing.assert_allclose(matrix_of(mounting.transform), UPSIDE_DOWN, atol=1e-15)


def test_the_velocity_is_the_mean_since_the_reading_before(tmp_path):
    write_bag(tmp_path / "log.bag", log())
    first, second, *_ = (message.twist.twist for message in of_topic(read(tmp_path / "log.bag"), "/odom"))
    assert (first.linear.x, first.linear.y, first.angular.z) == (0, 0, 0)
    got = np.array([second.linear.x, second.linear.y, second.angular.z])
    np.testing.assert_allclose(se2.exp(0.1 * got), [0.1, -0.05, 0.02], atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_each_beam_keeps_its_status(tmp_path, name):
    # The greatest double below 30 is 30 in single precision.
    ranges = [math.nextafter(30, 0), 30.0, math.inf, math.nan, -1.0, 0.05, 0.1, 5.0]
    told = scan(ranges=ranges, beams=8, range_min_m=0.1)
    write_bag(tmp_path / name, [Measurement(None, told)])
    (back,) = of_topic(read(tmp_path / name), "/scan")
    read_back = LaserScan.from_ranges(
        0, back.ranges, told.geometry, range_min_m=back.range_min, range_max_m=back.range_max
    )
    assert read_back.status.tolist() == told.status.tolist()
    assert np.isinf(back.ranges[1:3]).all()
    assert np.isnan(back.ranges[3:6]).all()


@pytest.mark.parametrize("name", NAMES)
def test_stamps_that_go_back_keep_the_order_of_the_log(tmp_path, name):
    stamps = [START + offset for offset in (0, 2 * S, S, S, 3 * S)]
    write_bag(tmp_path / name, (Measurement(Odometry.at(t, [k, 0, 0]), scan(t)) for k, t in enumerate(stamps)))
    messages = read(tmp_path / name)
    assert [stamp_of(message.header) for message in of_topic(messages, "/scan")] == stamps
    assert [message.pose.pose.position.x for message in of_topic(messages, "/odom")] == [0, 1, 2, 3, 4]
    assert all(a < b for (_, a, _), (_, b, _) in pairwise(messages))


def test_several_lasers(tmp_path):
    front, rear, third = UPSIDE_DOWN, se3.from_planar([-0.3, 0, math.pi]), np.eye(4)
    odometry = Odometry.at(START, [1, 2, 3])
    scans = [
        scan(mounting=front, sensor="front"),
        scan(mounting=rear, sensor="re ar", frame="/laser"),
        scan(mounting=third, sensor="/r1/top_scan", frame="base_link"),
        scan(mounting=rear, sensor="scan!", frame="laser_2"),
    ]
    write_bag(tmp_path / "log.mcap", (Measurement(odometry, one) for one in scans))
    messages = read(tmp_path / "log.mcap")
    assert [topic for topic, _, _ in messages if topic != "/tf_static"] == [
        "/odom",
        "/tf",
        "/scan",
        "/scan_re_ar",
        "/r1/top_scan",
        "/scan_scan_",
    ]
    frames = [message.header.frame_id for topic, _, message in messages if "scan" in topic]
    assert frames == ["laser", "laser_2", "base_link", "laser_2"]
    known = of_topic(messages, "/tf_static")[-1].transforms
    assert [link.child_frame_id for link in known] == ["laser", "laser_2"]
    for link, mounting in zip(known, (front, rear), strict=True):
        np.testing.assert_allclose(matrix_of(link.transform), mounting, atol=1e-15)


def test_what_messages_cannot_say_is_refused(tmp_path):
    uneven = scan(bearings=[0.0, 0.1, 0.3])
    too_far = replace(scan(), range_max_m=5.0)
    late = scan(beam_times_s=1e-4 * np.arange(90) + 0.1)
    backward = scan(beam_times_s=-1e-4 * np.arange(90))
    jerky = scan(beam_times_s=np.sqrt(np.arange(90)))
    cases = [
        ([uneven], "bearings: expected evenly spread beams"),
        ([too_far], "ranges: expected hits from 0 m on and below 5 m"),
        ([late], "beam_times_s: expected times that grow from 0"),
        ([backward], "beam_times_s: expected times that grow from 0"),
        ([jerky], "beam_times_s: expected evenly spread beams"),
        ([scan(), scan(mounting=np.eye(4))], "base_from_laser: expected one mounting for all scans of 'laser'"),
        ([scan(-1)], "stamp_ns"),
        ([scan(2**31 * S)], "stamp_ns"),
        ([], "measurements: expected at least one scan"),
    ]
    for name in NAMES:
        for scans, match in cases:
            with pytest.raises(ArgumentError, match=match):
                write_bag(tmp_path / name, (Measurement(None, one) for one in scans))
            assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_left_where_writing_fails(tmp_path, name):
    def failing():
        yield from log()
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_bag(tmp_path / name, failing())
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot be written"):
        write_bag(tmp_path / "file" / name, log())


@pytest.mark.parametrize("name", NAMES)
def test_a_file_is_replaced_and_a_folder_is_not(tmp_path, name):
    path = tmp_path / name
    if name != "log":
        path.write_text("before")
        write_bag(path, log())
        assert len(of_topic(read(path), "/scan")) == 5
        path.unlink()
    path.mkdir()
    (path / "thesis.tex").write_text("mine")
    with pytest.raises(OutputError, match="there is a folder"):
        write_bag(path, log())
    assert [file.name for file in path.iterdir()] == ["thesis.tex"]
