"""The node by Cyclone DDS in this process: what comes as bytes is a scan, or is named; nothing ends it."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="Cyclone DDS (the extra ros2) is not installed")

from gridslam.ros.node.messages import GridMessage
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.transport import TOPICS, RosNode
from gridslam.ros.ros2 import dds
from gridslam.ros.ros2.arguments import RosArguments
from gridslam.ros.ros2.ros2_dds import DdsTransport
from support.dds_peer import free_domain
from support.ros_bytes import encode_message
from support.ros_node import until

STAMP = 1_700_000_000, 5


def scan(beams):
    values = STAMP, "laser"
    empty = encode_message("sensor_msgs/LaserScan", (values, -1.0, 1.0, 2e-8, 0.0, 0.0, 0.1, 30.0, [], []))
    return empty[:-8] + beams.to_bytes(4, "little") + np.ones(beams, "<f4").tobytes() + bytes(4)


def test_bytes_that_are_no_scan_are_named_and_the_node_lives(capfd):
    transport = DdsTransport(RosArguments(), domain=free_domain(), interfaces=["127.0.0.1"])
    node = RosNode(transport, node_parameters({}, "default"))
    node.start()
    take = {reader.topic.name: partial(take, publisher="test") for reader, take in transport._participant._readers}
    try:
        take["rt/scan"](scan(26_214_400))
        take["rt/scan"](b"\0\1\0\0nonsense")
        take["rt/scan"](b"")
        take["rt/scan"](encode_message("std_msgs/Float64", (1.0,)))
        take["rt/tf"](b"\0\1\0\0\xff\xff\xff\xff")
        take["rq/gridslam/pauseRequest"](b"\0\1")
        said = []
        assert until(lambda: said.append(capfd.readouterr().err) or "request refused" in "".join(said))
        values = node.core.diagnostics().values
        assert values["refused"] == "1"
        assert values["message refused, times"] == "4"
        assert "scan refused: /scan: 26214400 beams, more than the maximum of 100000" in "".join(said)
        assert not node.core.ended.is_set()
    finally:
        node.close()
    assert node.core.failure is None


@pytest.mark.parametrize("known", ["11.", "no other"])
def test_bytes_arrive_as_they_were_sent_by_any_version(monkeypatch, known):
    """A version that is not known encodes itself what was encoded here: to the same bytes, more slowly."""
    monkeypatch.setattr(dds, "_KNOWN", known)
    participant, sent, got = dds.DdsParticipant(free_domain(), ["127.0.0.1"]), {}, []
    assert participant._carries_bytes == (known == "11.")
    outputs = EncodedOutputs(participant.encoder, sent.__setitem__, lambda: 0, lambda level, text: None, "node")
    outputs.map(GridMessage(5, "map", 0.05, (1.0, 2.0), np.arange(-1, 5, dtype=np.int8).reshape(2, 3)))
    participant.add_writer("rt/map", TOPICS["map"], latched=True)
    participant.publish("rt/map", sent["map"])
    participant.add_reader("rt/map", TOPICS["map"], lambda data, sender: got.append(data), latched=True)
    participant.start()
    try:
        assert until(lambda: bool(got))
    finally:
        participant.close()
    assert got[0].rstrip(b"\0") == sent["map"].rstrip(b"\0")  # the end may be padded
    assert decoded_cells(got[0]) == list(range(-1, 5))


def decoded_cells(data):
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(data, "nav_msgs/msg/OccupancyGrid").data.tolist()
