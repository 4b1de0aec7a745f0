"""The node by RTPS in this process: what comes as bytes is a scan, or is named; nothing ends it."""

from types import SimpleNamespace

import numpy as np
import pytest

from gridslam.errors import ConfigurationError
from gridslam.ros.node.messages import GridMessage
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.node.service_types import service_encoder
from gridslam.ros.node.transport import TOPICS
from gridslam.ros.ros2.arguments import RosArguments
from gridslam.ros.ros2.parameter_services import ParameterServices
from gridslam.ros.ros2_dds.dds_transport import DdsTransport
from gridslam.ros.ros2_dds.endpoints import Ros2Endpoints, decode_graph
from gridslam.ros.rtps.endpoints import RemoteEndpoint, Sample
from gridslam.ros.rtps.participant import Participant
from gridslam.ros.rtps.qos import Qos
from gridslam.ros.rtps.sockets import Sockets
from support.dds_peer import free_domain
from support.ros_bytes import encode_message
from support.ros_node import until

STAMP = 1_700_000_000, 5
WRITER = b"w" * 16


def scan(beams):
    values = STAMP, "laser"
    empty = encode_message("sensor_msgs/LaserScan", (values, -1.0, 1.0, 2e-8, 0.0, 0.0, 0.1, 30.0, [], []))
    return empty[:-8] + beams.to_bytes(4, "little") + np.ones(beams, "<f4").tobytes() + bytes(4)


def test_bytes_that_are_no_scan_are_named_and_the_node_lives(capfd):
    transport = DdsTransport(RosArguments(), domain=free_domain(), interfaces=["127.0.0.1"])
    node = RosNode(transport, node_parameters({}, "default"))
    node.start()
    readers = transport._participant._readers.values()
    take = {
        reader.topic: lambda data, handle=reader.handle: handle(Sample(data, WRITER, 1, b"\1\x10"))
        for reader in readers
    }
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


def endpoints(domain, node=("/", "")):
    return Ros2Endpoints(Participant(domain, ["127.0.0.1"]), node, service_encoder())


def test_bytes_arrive_as_they_were_sent():
    domain, sent, got = free_domain(), {}, []
    own, other = endpoints(domain), endpoints(domain)
    outputs = EncodedOutputs(service_encoder(), sent.__setitem__, lambda: 0, lambda level, text: None, "node")
    outputs.map(GridMessage(5, "map", 0.05, (1.0, 2.0), np.arange(-1, 5, dtype=np.int8).reshape(2, 3)))
    writer = own.add_writer("rt/map", TOPICS["map"], Qos(latched=True, depth=1))
    own._participant.write(writer, sent["map"])
    other.add_reader("rt/map", TOPICS["map"], lambda data, sender: got.append(data), Qos(latched=True, depth=1))
    for one in (own, other):
        one._participant.start()
    try:
        assert until(lambda: bool(got))
    finally:
        for one in (own, other):
            one._participant.close()
    assert got[0].rstrip(b"\0") == sent["map"].rstrip(b"\0")  # the end may be padded
    assert decoded_cells(got[0]) == list(range(-1, 5))


def test_publishers_are_named_by_their_nodes():
    domain, senders = free_domain(), []
    wheels, other = endpoints(domain, ("/robot1", "wheels")), endpoints(domain)
    writer = wheels.add_writer("rt/map", TOPICS["map"])
    other.add_reader("rt/map", TOPICS["map"], lambda data, sender: senders.append(sender))
    for one in (wheels, other):
        one._participant.start()

    def arrives_named():
        wheels._participant.write(writer, encode_message("std_msgs/Float64", (1.0,)))
        return "/robot1/wheels" in senders

    try:
        assert until(arrives_named)
        encoder = service_encoder()
        for writer in wheels._graph:  # of both layouts
            (payload,) = (stored.payload for stored in writer._history.values())
            assert decode_graph(encoder, payload) == {wheels._guids[1][0]: "/robot1/wheels"}
            assert not any(decode_graph(encoder, payload[:end]) for end in range(len(payload) - 4))
        assert decode_graph(encoder, b"\0\1\0\0" + b"\xff" * 200) == {}
    finally:
        for one in (wheels, other):
            one._participant.close()


def test_without_a_network_the_remedy_is_named(monkeypatch):
    def refuse(*arguments):
        raise OSError(99, "Cannot assign requested address")

    monkeypatch.setattr("gridslam.ros.rtps.sockets.socket.socket.setsockopt", refuse, raising=False)
    with pytest.raises(ConfigurationError, match=r"no network interface is up with 127\.0\.0\.1 .*ip link set lo up"):
        Sockets._sender("127.0.0.1")


def test_the_graph_of_nodes_has_gids_of_24_bytes_for_humble_and_of_16_from_iron_on():
    """Their layouts differ under one name; readers from Iron on state the hash of their type."""
    node = endpoints(free_domain(), ("/robot1", "gridslam"))
    node.add_writer("rt/map", TOPICS["map"], Qos(latched=True, depth=1))
    node.add_reader("rt/scan", "sensor_msgs/LaserScan", lambda data, sender: None)
    old, new = node._graph
    endpoint = RemoteEndpoint(b"g" * 16, "", "", Qos(latched=True), ("127.0.0.1", 1))
    hashed = endpoint._replace(user_data=b"typehash=RIHS01_00;")
    filters = node._participant._filters
    assert [filters[writer.guid](one) for writer in (old, new) for one in (endpoint, hashed)] == [
        True,
        False,
        False,
        True,
    ]
    (payload,) = (stored.payload for stored in old._history.values())
    graph = service_encoder().decode("rmw_dds_common/ParticipantEntitiesInfo", payload)
    (listed,) = graph.node_entities_info_seq
    assert (listed.node_namespace, listed.node_name) == ("/robot1", "gridslam")
    assert bytes(graph.gid.data.tolist()) == node._participant.guid + bytes(8)
    assert (len(listed.reader_gid_seq), len(listed.writer_gid_seq)) == (1, 1)
    (payload,) = (stored.payload for stored in new._history.values())
    assert payload[4:20] == node._participant.guid
    assert payload[20:24] == b"\1\0\0\0"
    texts = (4 + len("/robot1\0")) + (4 + len("gridslam\0") + 3)  # length, text, and filled up to four bytes
    assert len(payload) == len(b"\0\1\0\0") + 16 + 4 + texts + (4 + 16) + (4 + 16)
    node._participant.close()


@pytest.mark.parametrize(
    ("value", "settable", "says"),
    [(True, True, ""), (3, False, "start it with -p particles:="), ("yes", False, "expected a value like False")],
)
def test_parameters_are_set_or_the_reason_is_given(value, settable, says):
    changed = []
    values = {"particles": 30, "paused": False, "out": "", "share": 0.5, "a.b": 1}
    services = ParameterServices(values, lambda *what: changed.append(what) or "", ["paused"]).services()
    encoder = service_encoder()
    name = "particles" if isinstance(value, int) and not isinstance(value, bool) else "paused"
    kind = 1 + (bool, int, float, str).index(type(value))
    fields = [False, 0, 0.0, "", [], [], [], [], []]
    fields[kind - 1] = value
    for service in ("set_parameters", "set_parameters_atomically"):
        type_name, serve = services[service]
        data = encoder.encode(f"{type_name}_RequestBody", [(name, (kind, *fields))])
        request = encoder.decode(f"{type_name}_RequestBody", data)
        reply = encoder.decode(
            f"{type_name}_ResponseBody", encoder.encode(f"{type_name}_ResponseBody", *serve(request))
        )
        result = reply.results[0] if service == "set_parameters" else reply.result
        assert result.successful is settable
        assert says in result.reason
    assert changed == ([("paused", True)] * 2 if settable else [])
    ((names, prefixes),) = services["list_parameters"][1](SimpleNamespace(prefixes=["a"], depth=0))
    assert (names, prefixes) == (["a.b"], ["a"])


def decoded_cells(data):
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr(data, "nav_msgs/msg/OccupancyGrid").data.tolist()
