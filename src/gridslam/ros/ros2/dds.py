"""ROS 2 topics by Cyclone DDS, without ROS.

rosbags encodes and decodes the messages; the library only transports their bytes. It calls `serialize`
and `deserialize` of a topic's message class, and these classes return the bytes unchanged: a grid of 1000 x 1000 cells
costs half a millisecond instead of a hundred for a list. Other versions of the library, which may not call these
methods, receive messages as objects and encode them themselves.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeAlias, final
from xml.sax.saxutils import quoteattr

from gridslam.errors import ConfigurationError
from gridslam.io.bags.encoder import MessageEncoder

__all__ = ["DdsParticipant", "Handler", "service_encoder"]

_KNOWN = "11."
_POLL_NS = 200_000_000
_MAX_MESSAGES = 64
_POLICIES: Final[Mapping[int, str]] = {2: "durability", 4: "deadline", 8: "liveliness", 11: "reliability"}

_REQUEST_HEADER = "uint64 guid\nint64 sequence\n"  # that rmw_cyclonedds prepends to requests and replies
_EMPTY = "uint8 structure_needs_at_least_one_member"
_SERVICES: Final[Mapping[str, str]] = {
    "nav_msgs/GetMap_Request": _EMPTY,
    "nav_msgs/GetMap_Response": "nav_msgs/OccupancyGrid map",
    "std_srvs/Empty_Request": _EMPTY,
    "std_srvs/Empty_Response": _EMPTY,
    "std_srvs/SetBool_Request": "bool data",
    "std_srvs/SetBool_Response": "bool success\nstring message",
    "std_srvs/Trigger_Request": _EMPTY,
    "std_srvs/Trigger_Response": "bool success\nstring message",
}

Handler: TypeAlias = Callable[[bytes, str], None]
"""Called with the bytes of a message and a name of its sender."""


def service_encoder() -> MessageEncoder:
    """Return an encoder that knows the requests and replies of the node's services, too."""
    encoder = MessageEncoder(is_ros1=False)
    for name, definition in _SERVICES.items():
        encoder.define(name, _REQUEST_HEADER + definition)
    return encoder


def _library() -> Any:  # noqa: ANN401
    try:
        names = ("builtin", "core", "domain", "idl", "idl.types", "pub", "qos", "sub", "topic", "util")
        for name in names:
            importlib.import_module(f"cyclonedds.{name}")
        return importlib.import_module("cyclonedds")
    except ImportError as error:
        hint = "pip install 'gridslam[ros2]', or source a ROS 2"
        raise ConfigurationError(f"Cyclone DDS is not available ({error}): {hint}") from None


@final
class DdsParticipant:
    """Writers and readers of one participant; one thread calls the handlers in the order of arrival.

    Parameters
    ----------
    domain : int
        ROS_DOMAIN_ID.
    interfaces : sequence of str
        Addresses or names of the network interfaces; if empty, the library chooses them.
    on_mismatch : callable
        Called with an incompatibility of another program, so that nothing passes: "quality of service" or "message
        type", the topic, and a description.

    Attributes
    ----------
    encoder : MessageEncoder
        Of the messages, requests and replies.

    Raises
    ------
    ConfigurationError
        Cyclone DDS is not installed, or cannot use the interfaces.
    """

    def __init__(
        self,
        domain: int,
        interfaces: Sequence[str] = (),
        on_mismatch: Callable[[str, str, str], None] = lambda *unused: None,
    ) -> None:
        self._dds = dds = _library()
        self.encoder = service_encoder()
        self._on_mismatch = on_mismatch
        self._carries_bytes = importlib.metadata.version("cyclonedds").startswith(_KNOWN)
        self._types: dict[str, Any] = {}
        self._writers: dict[str, Any] = {}
        self._readers: list[tuple[Any, Handler]] = []
        self._closed = threading.Event()
        try:
            self._domain = dds.domain.Domain(domain, _configuration(interfaces)) if interfaces else None
            self._participant = dds.domain.DomainParticipant(domain)
        except dds.core.DDSException as error:
            where = ", ".join(interfaces) or "any interface"
            raise ConfigurationError(f"DDS cannot start in domain {domain} on {where}: {error.msg}") from None
        self._wait_set = dds.core.WaitSet(self._participant)
        self._publishers = dds.builtin.BuiltinDataReader(self._participant, dds.builtin.BuiltinTopicDcpsPublication)
        self._attach(self._publishers)
        self._thread = threading.Thread(target=self._listen, name="gridslam-dds", daemon=True)

    def add_writer(self, topic: str, message_type: str, *, latched: bool = False, depth: int = 10) -> None:
        """Add a writer for a DDS topic; `latched`: late subscribers receive the last message."""
        qos = self._qos(reliable=True, latched=latched, depth=1 if latched else depth)
        listener = self._dds.core.Listener(
            on_offered_incompatible_qos=lambda writer, status: self._mismatch(topic, "subscriber asks for more", status)
        )
        what = self._topic(topic, message_type)
        self._writers[topic] = self._dds.pub.DataWriter(self._participant, what, qos, listener)

    def add_reader(
        self,
        topic: str,
        message_type: str,
        handle: Handler,
        *,
        reliable: bool = True,
        latched: bool = False,
        depth: int = 10,
    ) -> None:
        """Add a handler for the bytes of each message on a DDS topic, before `start`."""
        dds = self._dds
        qos = self._qos(reliable=reliable, latched=latched, depth=depth)
        listener = dds.core.Listener(
            on_requested_incompatible_qos=lambda reader, status: self._mismatch(topic, "publisher offers less", status)
        )
        reader = dds.sub.DataReader(self._participant, self._topic(topic, message_type), qos, listener)
        self._attach(reader)
        self._readers.append((reader, handle))

    def start(self) -> None:
        """Start the thread that reads messages."""
        self._thread.start()

    def publish(self, topic: str, data: bytes) -> None:
        """Publish bytes on a topic that has a writer."""
        writer = self._writers[topic]
        writer.write(writer.data_type.deserialize(data))

    def close(self) -> None:
        """Stop the thread."""
        self._closed.set()
        if self._thread.ident is not None:
            self._thread.join(timeout=5)

    def _listen(self) -> None:
        while not self._closed.is_set():
            self._wait_set.wait(_POLL_NS)
            for reader, handle in self._readers:
                for message in reader.take(_MAX_MESSAGES):
                    if message.sample_info.valid_data:  # else it only indicates that a writer has gone
                        sender = f"publisher {message.sample_info.publication_handle:x}"
                        handle(message.serialize(use_version_2=False), sender)

            for publisher in self._publishers.take(_MAX_MESSAGES):
                if publisher.sample_info.valid_data:
                    self._check_type(publisher.topic_name, publisher.type_name)

    def _attach(self, reader: Any) -> None:  # noqa: ANN401
        core = self._dds.core
        states = core.ViewState.Any | core.InstanceState.Any | core.SampleState.NotRead
        self._wait_set.attach(core.ReadCondition(reader, states))

    def _check_type(self, topic: str, typename: str) -> None:
        """Report a publisher with another message type than a reader: the library does not."""
        for reader, _ in self._readers:
            expected = reader.topic.typename
            if reader.topic.name == topic and typename != expected:
                self._on_mismatch("message type", topic, f"a publisher sends {typename}, this node expects {expected}")

    def _mismatch(self, topic: str, who: str, status: Any) -> None:  # noqa: ANN401
        policy = _POLICIES.get(status.last_policy_id, f"policy {status.last_policy_id}")
        self._on_mismatch("quality of service", topic, f"a {who} {policy} than this node, so no message passes")

    def _topic(self, name: str, message_type: str) -> Any:  # noqa: ANN401
        return self._dds.topic.Topic(self._participant, name, self._carrier(message_type))

    def _carrier(self, message_type: str) -> Any:  # noqa: ANN401
        """Return a message class that consists of its encoded bytes."""
        if not self._carries_bytes:
            return self._struct(message_type)
        kind = f"{message_type}*"
        if kind not in self._types:
            carrier = self._types[kind] = self._struct(message_type)
            carrier.serialize = _to_bytes
            carrier.deserialize = carrier.deserialize_key = classmethod(_from_bytes)
        return self._types[kind]

    def _struct(self, message_type: str) -> Any:  # noqa: ANN401
        """Return the library's class of a type, with its name and fields."""
        types = self._dds.idl.types
        fields = {}
        for name, kind, length in self.encoder.fields(message_type):
            one = self._element(kind)
            if length is not None:
                one = types.array[one, length] if length else types.sequence[one]
            fields[name] = one
        package, *_, name = message_type.split("/")
        space = "srv" if name.endswith(("_Request", "_Response")) else "msg"
        return self._dds.idl.make_idl_struct(f"{name}_", f"{package}.{space}.dds_.{name}_", fields)

    def _element(self, kind: str) -> Any:  # noqa: ANN401
        if kind not in self._types:
            types = self._dds.idl.types
            plain = {"string": str, "bool": bool, "byte": types.uint8}
            self._types[kind] = self._struct(kind) if "/" in kind else plain.get(kind) or getattr(types, kind)
        return self._types[kind]

    def _qos(self, *, reliable: bool, latched: bool, depth: int) -> Any:  # noqa: ANN401
        policy = self._dds.qos.Policy
        return self._dds.qos.Qos(
            policy.Reliability.Reliable(self._dds.util.duration(milliseconds=100))
            if reliable
            else policy.Reliability.BestEffort,
            policy.Durability.TransientLocal if latched else policy.Durability.Volatile,
            policy.History.KeepLast(depth),
            policy.DataRepresentation(use_cdrv0_representation=True),
        )


def _to_bytes(message: Any, *unused: object, **options: object) -> bytes:  # noqa: ANN401
    data: bytes = message.cdr
    return data


def _from_bytes(cls: Any, /, data: bytes, *unused: object, **options: object) -> Any:  # noqa: ANN401
    message = object.__new__(cls)
    message.cdr = data
    return message


def _configuration(interfaces: Sequence[str]) -> str:
    """Return Cyclone DDS's configuration for these interfaces; on loopback with unicast discovery."""
    named = [
        f"<NetworkInterface {'address' if name[0].isdigit() or ':' in name else 'name'}={quoteattr(name)}/>"
        for name in interfaces
    ]
    local = all(name in ("127.0.0.1", "lo", "::1") for name in interfaces)
    discovery = (
        "<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
        "<Peers><Peer address='127.0.0.1'/></Peers></Discovery>"
    )
    multicast = "<AllowMulticast>false</AllowMulticast>" if local else ""
    return (
        f"<CycloneDDS><Domain><General><Interfaces>{''.join(named)}</Interfaces>{multicast}</General>"
        f"{discovery if local else ''}</Domain></CycloneDDS>"
    )
