"""Messages of logs are decoded in all three ways in which they are written."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.io.bags.encoder import MessageEncoder, MessageError
from gridslam.io.bags.ros_messages import decode_odometry, decode_scan, decode_transforms, kind_of
from support import ros_bags

MAKERS = {"ros1": ros_bags.Maker(True), "cdr": ros_bags.Maker(False), "big-endian cdr": ros_bags.Maker(False)}
ENCODERS = {form: MessageEncoder(is_ros1=form == "ros1") for form in MAKERS}
NAMES = st.text(st.sampled_from("abz_/"), max_size=9)  # of all lengths modulo 8: what aligning depends on
NUMBERS = st.floats(-1e6, 1e6)
HOURS = st.floats(0, 1e5)


def written(form, said):
    return MAKERS[form].bytes_of(said, little_endian=form != "big-endian cdr")


@pytest.mark.parametrize("form", MAKERS)
@settings(max_examples=40, deadline=None)
@given(frame=NAMES, at_s=HOURS, ranges=st.lists(st.floats(width=32), max_size=9), start=st.floats(-7, 7, width=32))
def test_scans(form, frame, at_s, ranges, start):
    said = ros_bags.scan("/s", at_s, ranges, frame=frame, angles=(start, 0.25), time_increment=0.125)
    got = decode_scan(written(form, said), ENCODERS[form])
    np.testing.assert_array_equal(got.ranges, np.array(ranges, np.float32))
    assert got[:5] == (ros_bags.ns(at_s), frame.lstrip("/"), start, 0.25, 0.125)


@pytest.mark.parametrize("form", MAKERS)
@settings(max_examples=40, deadline=None)
@given(frame=NAMES, child=NAMES, pose=st.tuples(NUMBERS, NUMBERS, st.floats(-3, 3)), at_s=HOURS)
def test_odometry(form, frame, child, pose, at_s):
    said = ros_bags.odometry("/o", at_s, pose, frames=(frame, child))
    got = decode_odometry(written(form, said), ENCODERS[form])
    assert got[:3] == (ros_bags.ns(at_s), frame.lstrip("/"), child.lstrip("/"))
    assert got.pose == pytest.approx((*pose[:2], 0, 0, 0, math.sin(pose[2] / 2), math.cos(pose[2] / 2)), abs=1e-12)


@pytest.mark.parametrize("form", MAKERS)
@settings(max_examples=40, deadline=None)
@given(links=st.lists(st.tuples(NAMES, NAMES, st.tuples(NUMBERS, NUMBERS, NUMBERS)), max_size=4), at_s=HOURS)
def test_transforms(form, links, at_s):
    maker = MAKERS[form]
    each = [ros_bags.transform(at_s, *link, xyzw=(0.1, 0.2, 0.3, 0.4)) for link in links]
    message = maker.types["tf2_msgs/msg/TFMessage"]([said.make(maker).transforms[0] for said in each])
    said = ros_bags.Said("/tf", 0, "tf2_msgs/msg/TFMessage", lambda _: message)
    got = decode_transforms(written(form, said), ENCODERS[form])
    assert got == [
        (ros_bags.ns(at_s), parent.lstrip("/"), child.lstrip("/"), (*place, 0.1, 0.2, 0.3, 0.4))
        for parent, child, place in links
    ]


@pytest.mark.parametrize("form", MAKERS)
def test_every_truncation_is_told(form):
    said = (
        (ros_bags.scan("/s", 0.0, [1.0, 2.0]), decode_scan),
        (ros_bags.odometry("/o", 0.0, (1.0, 2.0, 3.0)), decode_odometry),
        (ros_bags.transform(0.0, "a", "bc"), decode_transforms),
    )
    for message, decode in said:
        data = written(form, message)
        for length in range(len(data)):
            with pytest.raises(MessageError):
                decode(data[:length], ENCODERS[form])


@pytest.mark.parametrize("head", [b"", b"\0", b"\0\2\0\0", b"\0\7\0\0", b"\x28\xb5\x2f\xfd"])
def test_other_encodings_are_refused(head):
    with pytest.raises(MessageError, match="CDR encapsulation"):
        decode_scan(head, ENCODERS["cdr"])


def test_angles_that_are_not_finite_are_refused():
    for angles in ((math.nan, 0.1), (0.0, math.inf)):
        data = written("cdr", ros_bags.scan("/s", 0.0, [1.0], angles=angles))
        with pytest.raises(MessageError, match="angles"):
            decode_scan(data, ENCODERS["cdr"])


@pytest.mark.parametrize(
    ("type_", "kind"),
    [
        ("sensor_msgs/LaserScan", "scan"),
        ("sensor_msgs/msg/LaserScan", "scan"),
        ("tf/tfMessage", "transforms"),
        ("tf/msg/tfMessage", "transforms"),
        ("tf2_msgs/msg/TFMessage", "transforms"),
        ("nav_msgs/msg/Odometry", "odometry"),
        ("sensor_msgs/msg/MultiEchoLaserScan", ""),
        ("", ""),
    ],
)
def test_kinds(type_, kind):
    assert kind_of(type_) == kind
