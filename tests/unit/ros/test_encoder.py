"""Messages as bytes: what is encoded is what rosbags decodes, in ROS 1 and ROS 2."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridslam.io.bags.encoder import MessageEncoder, MessageError
from gridslam.io.bags.ros_messages import decode_transforms
from gridslam.ros.node.messages import CloudMessage, Diagnostics, GridMessage, Level, PoseMessage, StampedTransform
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.transport import TOPICS

STAMP = 1_700_000_000_123_456_789
ENCODERS = {"ROS 1": MessageEncoder(is_ros1=True), "ROS 2": MessageEncoder(is_ros1=False)}
NUMBERS = {
    "bool": st.booleans(),
    "byte": st.integers(0, 127),
    "uint8": st.integers(0, 127),
    "int8": st.integers(-128, 127),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "int64": st.integers(-(2**63), 2**63 - 1),
    "uint64": st.integers(0, 2**64 - 1),
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
    "string": st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9),
}
TYPES = [*TOPICS.values(), "sensor_msgs/LaserScan", "nav_msgs/Odometry", "rosgraph_msgs/Clock"]


def values_of(encoder, kind):
    if kind in NUMBERS:
        return NUMBERS[kind]
    return st.tuples(*(field_values(encoder, field) for field in encoder.fields(kind)))


def field_values(encoder, field):
    one = st.integers(0, 2**31 - 1) if field.name in ("sec", "nanosec") else values_of(encoder, field.type)
    if field.length is None:
        return one
    return st.lists(one, min_size=field.length, max_size=field.length or 4)


def plain(message: object) -> object:
    """Nested tuples of what rosbags decoded."""
    if isinstance(message, np.ndarray):
        return tuple(message.tolist())
    if isinstance(message, list):
        return tuple(map(plain, message))
    fields = getattr(message, "__dataclass_fields__", None)
    return message if fields is None else tuple(plain(getattr(message, name)) for name in fields if _is_field(name))


def _is_field(name: str) -> bool:
    return not name.isupper() and name[:2] != "__"  # constants are not sent


def nested(values: object) -> object:
    return tuple(map(nested, values)) if isinstance(values, list | tuple) else values


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_what_was_encoded_is_decoded(data):
    encoder = ENCODERS[data.draw(st.sampled_from(list(ENCODERS)))]
    kind = data.draw(st.sampled_from([kind for kind in TYPES if encoder is ENCODERS["ROS 2"] or "Clock" not in kind]))
    values = data.draw(values_of(encoder, kind))
    assert plain(encoder.decode(kind, encoder.encode(kind, *values))) == nested(values)


@pytest.mark.parametrize("data", [b"", b"\0\7\0\0", b"\0\1\0\0\1"])
def test_what_is_no_message_is_refused(data):
    with pytest.raises(MessageError, match=r"CDR encapsulation|unpack_from requires"):
        ENCODERS["ROS 2"].decode("std_msgs/Float64", data)


@pytest.mark.parametrize("ros", ENCODERS)
def test_what_the_node_says_is_what_is_heard(ros):
    sent: dict[str, bytes] = {}
    encoder = ENCODERS[ros]
    outputs = EncodedOutputs(encoder, sent.__setitem__, lambda: STAMP, lambda level, text: None, "gridslam")
    cells = np.arange(-1, 5, dtype=np.int8).reshape(2, 3)
    outputs.map(GridMessage(STAMP, "map", 0.05, (-1.5, 2.5), cells))
    outputs.transform(StampedTransform(STAMP, "map", "odom", (1.0, 2.0, 0.0, 0.0, 0.0, 0.6, 0.8)))
    outputs.pose(PoseMessage(STAMP, "map", np.array([1.0, 2.0, np.pi / 2]), np.arange(9.0).reshape(3, 3)))
    outputs.entropy(1.25)
    outputs.particles(
        CloudMessage(STAMP, "map", np.array([[1.0, 2.0, np.pi / 2], [3.0, 4.0, 0.0]]), np.array([0.25, 0.75]))
    )
    outputs.diagnostics(Diagnostics(Level.WARN, "behind", {"dropped": "3"}))
    heard = {topic: encoder.decode(kind, sent[topic]) for topic, kind in TOPICS.items()}
    grid = heard["map"]
    assert (grid.info.width, grid.info.height, grid.header.frame_id) == (3, 2, "map")
    assert (grid.info.origin.position.x, grid.info.origin.position.y, grid.info.origin.orientation.w) == (-1.5, 2.5, 1)
    assert grid.info.resolution == pytest.approx(0.05)
    assert grid.data.tolist() == cells.ravel().tolist()
    assert grid.header.stamp.sec * 10**9 + grid.header.stamp.nanosec == STAMP
    assert heard["map_metadata"] == grid.info
    assert decode_transforms(sent["/tf"], encoder) == [
        StampedTransform(STAMP, "map", "odom", (1.0, 2.0, 0.0, 0.0, 0.0, 0.6, 0.8))
    ]
    pose = heard["~/pose"].pose
    assert pose.covariance.reshape(6, 6)[np.ix_((0, 1, 5), (0, 1, 5))].ravel().tolist() == list(range(9))
    assert pose.pose.orientation.z == pytest.approx(np.sqrt(0.5))
    assert heard["~/entropy"].data == 1.25
    assert [(one.position.x, one.position.y) for one in heard["particlecloud"].poses] == [(1, 2), (3, 4)]
    assert heard["particlecloud"].poses[0].orientation.z == pytest.approx(np.sqrt(0.5))
    (status,) = heard["/diagnostics"].status
    assert (status.level, status.message, status.values[0].key, status.values[0].value) == (1, "behind", "dropped", "3")


@pytest.mark.parametrize("ros", ENCODERS)
def test_a_large_map_costs_little(ros):
    outputs = EncodedOutputs(
        ENCODERS[ros], lambda topic, data: None, lambda: STAMP, lambda level, text: None, "gridslam"
    )
    grid = GridMessage(STAMP, "map", 0.05, (0.0, 0.0), np.zeros((1000, 1000), np.int8))
    times = []
    for _ in range(5):
        begin = time.thread_time()
        outputs.map(grid)
        times.append(time.thread_time() - begin)
    assert min(times) < 0.02  # as a list it would take 0.1 s
