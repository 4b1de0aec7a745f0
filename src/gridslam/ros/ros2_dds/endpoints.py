"""ROS 2's topics, services and graph by RTPS, without ROS: what rmw_fastrtps and rmw_cyclonedds make of them.

rosbags encodes and decodes the messages; their bytes are sent and received as they are.
"""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, final

import numpy as np

from gridslam.io.bags.encoder import MessageEncoder
from gridslam.io.bags.ros_messages import MessageError
from gridslam.pipeline import describe_error
from gridslam.ros.node.service_types import BODY, GRAPH, GRAPH_FROM_IRON
from gridslam.ros.node.transport import Handler, Serve
from gridslam.ros.rtps.endpoints import RemoteEndpoint, Sample
from gridslam.ros.rtps.participant import Participant
from gridslam.ros.rtps.qos import Qos
from gridslam.ros.rtps.reader import RELATED
from gridslam.ros.rtps.writer import Writer

_CYCLONE: Final = b"\1\x10"
"""Vendor of Eclipse Cyclone DDS, whose rmw puts a header before requests and replies."""

_GRAPH: Final = "ros_discovery_info"
_GRAPHS: Final = {GRAPH: 24, GRAPH_FROM_IRON: 16}
"""Bytes of a GID by the type of the graph of nodes."""

_TYPE_HASH: Final = b"typehash="
_MATCH_S: Final = 1.0
_MAX_NAMES: Final = 500  # participants whose nodes are known by name

_DEFAULT: Final = Qos()


@final
class Ros2Endpoints:
    """Writers, readers and services of a node; the participant's thread calls the handlers in the order of arrival.

    Parameters
    ----------
    participant : Participant
        Whose they are.
    node : (str, str)
        Namespace and name of the node, as others list it; no name: it is not listed.
    encoder : MessageEncoder
        Of the messages, requests and replies.
    """

    def __init__(self, participant: Participant, node: tuple[str, str], encoder: MessageEncoder) -> None:
        self._participant = participant
        self._encoder = encoder
        self._node = node
        self._guids: tuple[list[bytes], list[bytes]] = [], []  # of readers and writers
        self._graph: list[Writer] = []
        self._names: dict[bytes, dict[bytes, str]] = {}  # of each participant the nodes of its writers
        ends = _GRAPH, _type_name(GRAPH)
        self._participant.add_reader(*ends, Qos(latched=True, depth=_MAX_NAMES), self._note_names)
        if node[1]:
            qos = Qos(latched=True, depth=1)
            self._graph = [self._participant.add_writer(*ends, qos, only) for only in (_is_old_ros, _is_new_ros)]

    def add_writer(self, topic: str, message_type: str, qos: Qos = _DEFAULT) -> Writer:
        """Add a writer for a DDS topic, of which the participant writes."""
        writer = self._participant.add_writer(topic, _type_name(message_type), qos, user_data=self._hash(message_type))
        self._guids[1].append(writer.guid)
        self._publish_graph()
        return writer

    def add_reader(self, topic: str, message_type: str, handle: Handler, qos: Qos = _DEFAULT) -> None:
        """Add a handler for the bytes of each message on a DDS topic."""

        def take(sample: Sample) -> None:
            if not sample.is_gone:
                handle(sample.payload, self._name_of(sample.writer))

        self._add_reader(topic, message_type, qos, take, self._hash(message_type))

    def _note_names(self, sample: Sample) -> None:
        """Note which writers belong to which node, as the participants of ROS state it."""
        participant = sample.writer[:12]
        self._names.pop(participant, None)
        names = {} if sample.is_gone else decode_graph(self._encoder, sample.payload)  # none, too, of one that ends
        if names and len(self._names) < _MAX_NAMES:
            self._names[participant] = names

    def _name_of(self, writer: bytes) -> str:
        """Return the name of a writer's node; where that is not known its number."""
        return self._names.get(writer[:12], {}).get(writer) or f"publisher {writer.hex()}"

    def add_service(
        self, name: str, service_type: str, serve: Serve, refuse: Callable[[str], None], *, slow: bool = False
    ) -> None:
        """Offer a service.

        Parameters
        ----------
        name : str
            Full name.
        service_type : str
            Such as "std_srvs/SetBool".
        serve : callable
            Called with the request; returns the values of the reply's fields.
        refuse : callable
            Called with the reason for which a request is no request of this type.
        slow : bool
            Whether it is served in a thread of its own.
        """
        qos = Qos(depth=100)
        kind = f"{service_type}_Response"
        reply = self._participant.add_writer(f"rr{name}Reply", _type_name(kind), qos)
        self._guids[1].append(reply.guid)

        def answer(sample: Sample, request: Any) -> None:  # noqa: ANN401
            try:
                values = serve(request) or (0,)  # a structure without fields has one all the same
            except Exception as error:  # the thread goes on, whatever was asked
                refuse(describe_error(error))
                return
            self._wait_for(reply, sample)
            if sample.vendor == _CYCLONE:
                self._participant.write(reply, self._encoder.encode(kind, request.guid, request.sequence, *values))
            else:
                identity = _identity(sample)
                parameters = [(parameter, identity) for parameter in RELATED]
                self._participant.write(reply, self._encoder.encode(kind + BODY, *values), parameters)

        def take(sample: Sample) -> None:
            if sample.is_gone:
                return
            try:
                body = "" if sample.vendor == _CYCLONE else BODY
                request = self._encoder.decode(f"{service_type}_Request{body}", sample.payload)
            except MessageError as error:
                refuse(str(error))
                return
            if slow or not self._is_matched(reply, sample):
                threading.Thread(target=answer, args=(sample, request), daemon=True).start()
            else:
                answer(sample, request)

        self._add_reader(f"rq{name}Request", f"{service_type}_Request", qos, take)

    def _add_reader(
        self, topic: str, message_type: str, qos: Qos, take: Callable[[Sample], None], user_data: bytes = b""
    ) -> None:
        reader = self._participant.add_reader(topic, _type_name(message_type), qos, take, user_data)
        self._guids[0].append(reader.guid)
        self._publish_graph()

    def _hash(self, message_type: str) -> bytes:
        """Return the user data by which an endpoint states the hash of its type."""
        return _TYPE_HASH + self._encoder.type_hash(message_type).encode() + b";"

    def _publish_graph(self) -> None:
        """State which readers and writers are the node's, by which `ros2 node list` knows it."""
        for writer, (kind, size) in zip(self._graph, _GRAPHS.items(), strict=False):
            own, *groups = (
                [(np.frombuffer(guid.ljust(size, b"\0"), np.uint8),) for guid in guids]
                for guids in ([self._participant.guid], *self._guids)
            )
            self._participant.write(writer, self._encoder.encode(kind, *own, [(*self._node, *groups)]))

    @staticmethod
    def _is_matched(reply: Writer, sample: Sample) -> bool:
        """Whether who has asked would get the reply."""
        return any(guid[:12] == sample.writer[:12] for guid in list(reply.readers))

    def _wait_for(self, reply: Writer, sample: Sample) -> None:
        """Wait until the one who has asked is known as a reader of replies."""
        end_s = time.monotonic() + _MATCH_S
        while not self._is_matched(reply, sample) and time.monotonic() < end_s:
            time.sleep(0.005)


def _is_new_ros(reader: RemoteEndpoint) -> bool:
    return _TYPE_HASH in reader.user_data


def _is_old_ros(reader: RemoteEndpoint) -> bool:
    return not _is_new_ros(reader)


def _type_name(message_type: str) -> str:
    """Name of a type in DDS."""
    package, *_, name = message_type.split("/")
    space = "srv" if name.endswith(("_Request", "_Response")) else "msg"
    return f"{package}::{space}::dds_::{name}_"


def _identity(sample: Sample) -> bytes:
    """Return the identity of a request: of the reader of its reply if that is known, else of its writer."""
    guid = sample.related[:16]
    if len(guid) < 16 or not any(guid):
        guid = sample.writer
    return guid + struct.pack("<iI", sample.sequence >> 32, sample.sequence & 0xFFFFFFFF)


def decode_graph(encoder: MessageEncoder, payload: bytes) -> dict[bytes, str]:
    """Return the full name of each writer's node, from the graph of a participant; none if it is damaged.

    Of the two layouts that one is right by which the message ends where it should.
    """
    for kind in _GRAPHS:
        with suppress(MessageError):
            nodes = encoder.decode(kind, payload).node_entities_info_seq
            return {
                bytes(one.data[:16].tolist()): f"{node.node_namespace.rstrip('/')}/{node.node_name}"
                for node in nodes
                for one in node.writer_gid_seq
            }
    return {}
