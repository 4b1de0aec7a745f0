"""The node in ROS 2 without ROS: by RTPS, as `ros2 node`, `ros2 topic`, `ros2 service` and `ros2 param` expect it."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from typing import Any, final

import numpy as np

from gridslam.errors import ConfigurationError
from gridslam.io.bags.encoder import Values
from gridslam.io.bags.ros_messages import MessageError, Wire, wire_of_cdr
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.messages import GridMessage, Level, Outputs
from gridslam.ros.node.outputs import EncodedOutputs, grid_values
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.transport import LATCHED, POLL_S, TOPICS, Handler, RosNode, TypedService, ViewerOpener
from gridslam.ros.ros2.arguments import RosArguments, parse_ros_arguments
from gridslam.ros.ros2.dds import DdsParticipant
from gridslam.ros.ros2.lifecycle_services import TRANSITION_EVENT, LifecycleServices
from gridslam.ros.ros2.parameter_services import ParameterServices
from gridslam.ros.rtps.qos import Qos

__all__ = ["DdsTransport", "run_dds"]

_LEVELS = {Level.OK: "INFO", Level.WARN: "WARN", Level.ERROR: "ERROR"}
_EMPTY_GRID = GridMessage(0, "", 0.0, (0.0, 0.0), np.zeros((0, 0), np.int8))


@final
class DdsTransport:
    """Writers, readers and services of the node.

    Parameters
    ----------
    arguments : RosArguments
        Names and remappings.
    domain : int
        ROS_DOMAIN_ID.
    interfaces : sequence of str
        Network interfaces; if empty, the library chooses them.
    simulated : bool
        Whether to use the time of /clock.
    peers : sequence of str
        Addresses of machines that multicast does not reach.
    """

    global_localization = "reinitialize_global_localization"

    def __init__(
        self,
        arguments: RosArguments,
        *,
        domain: int = 0,
        interfaces: Sequence[str] = (),
        simulated: bool = False,
        peers: Sequence[str] = (),
    ) -> None:
        self._refuse: Callable[[str, str], None] = lambda kind, problem: None
        self._arguments = arguments
        self._clock_ns: int | None = 0 if simulated else None
        node = arguments.namespace, arguments.node
        self._participant = DdsParticipant(domain, interfaces, self._on_mismatch, node, peers)
        self._encoder = self._participant.encoder
        self.outputs: Outputs = EncodedOutputs(self._encoder, self._publish, self._now_ns, self._log, arguments.node)
        if arguments.ignored:
            self._log(Level.WARN, f"arguments that are ignored, as there is no ROS: {', '.join(arguments.ignored)}")
        for sentence in arguments.foreign_files:
            self._log(Level.WARN, sentence)
        self._writers: dict[str, str] = {}
        self._parameters: ParameterServices | None = None

    def connect(self, refuse: Callable[[str, str], None], topics: Mapping[str, str] = TOPICS) -> None:
        """Create the writers; `refuse` is called with kind and problem of what cannot be received."""
        self._refuse = refuse
        self.outputs.topics = tuple(topics)
        for topic, kind in topics.items():
            name = self.resolve(topic)
            self._writers[topic] = f"rt{name}"
            latched = topic in LATCHED
            qos = self._arguments.override_qos(name, "publisher", Qos(latched=latched, depth=1 if latched else 10))
            self._participant.add_writer(self._writers[topic], kind, qos)
        if self._clock_ns is not None:
            self.subscribe("/clock", "rosgraph_msgs/Clock", self._on_clock, reliable=False, depth=1)

    def wire_of(self, data: bytes) -> Wire:
        """Return the encoding of a message; raises MessageError if it has none."""
        return wire_of_cdr(data)

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic, after remapping."""
        return self._arguments.resolve(topic)

    def subscribe(
        self, topic: str, kind: str, handle: Handler, *, reliable: bool = True, latched: bool = False, depth: int = 10
    ) -> None:
        """Subscribe to the bytes of messages."""
        name = self.resolve(topic)
        qos = self._arguments.override_qos(name, "subscription", Qos(reliable=reliable, latched=latched, depth=depth))
        self._participant.add_reader(f"rt{name}", kind, handle, qos)

    def advertise(self, service: str, kind: str, serve: Callable[[Any], Sequence[Any]], *, slow: bool = False) -> None:
        """Offer a service; a slow one answers in a thread of its own."""
        name = self.resolve(service)
        self._add_service(name, kind, lambda request: serve(getattr(request, "data", None)), slow=slow)

    def advertise_parameters(
        self, values: Mapping[str, Any], change: Callable[[str, Any], str], settable: Sequence[str]
    ) -> None:
        """Offer the parameters to `ros2 param`."""
        values = {**values, "use_sim_time": self._clock_ns is not None}
        self._parameters = ParameterServices(values, change, settable)
        for name, (kind, serve) in self._parameters.services().items():
            self._add_service(self.resolve(f"~/{name}"), kind, serve)

    def advertise_typed(self, package: str, services: Mapping[str, TypedService]) -> bool:
        """Return False: types of packages differ between versions, and none is installed here."""
        return False

    def advertise_set_map(self, service: str, serve: Callable[[Any], bool]) -> None:
        """Offer a service of nav_msgs/SetMap."""
        self._add_service(self.resolve(service), "nav_msgs/SetMap", lambda request: (serve(request),), slow=True)

    def advertise_lifecycle(self, core: NodeCore) -> None:
        """Offer the services of a managed node: it maps while it is active, and forgets when it is cleaned up."""
        topic = f"rt{self.resolve('~/transition_event')}"
        self._participant.add_writer(topic, TRANSITION_EVENT)

        def publish(values: Values) -> None:
            self._participant.publish(topic, self._encoder.encode(TRANSITION_EVENT, *values))

        lifecycle = LifecycleServices(lambda active: core.pause(not active), core.reset, publish, self._now_ns)
        for name, (kind, serve) in lifecycle.services().items():
            self._add_service(self.resolve(f"~/{name}"), kind, serve)

    def save_parameters(self, values: Mapping[str, float]) -> None:
        """Set parameters of the node."""
        if self._parameters is not None:
            self._parameters.store(values)

    def _add_service(self, name: str, kind: str, serve: Callable[[Any], Sequence[Any]], *, slow: bool = False) -> None:
        def refuse(problem: str) -> None:
            self._refuse("request", f"{name}: {problem}")

        self._participant.add_service(name, kind, serve, refuse, slow=slow)

    def advertise_map(self, service: str, serve: Callable[[], GridMessage | None]) -> None:
        """Offer the map by a service; without a map the response is empty."""

        def serve_values(request: Any) -> Sequence[Any]:  # noqa: ANN401
            return (grid_values(self._encoder, service, serve() or _EMPTY_GRID),)

        self.advertise(service, "nav_msgs/GetMap", serve_values)

    def spin(self, ended: threading.Event) -> Iterator[None]:
        """Deliver messages until the event is set."""
        self._participant.start()
        while not ended.wait(POLL_S):
            yield

    def close(self) -> None:
        """Shut down."""
        self._participant.close()

    def _publish(self, topic: str, data: bytes) -> None:
        if topic in self._writers:
            self._participant.publish(self._writers[topic], data)

    def _now_ns(self) -> int:
        return time.time_ns() if self._clock_ns is None else self._clock_ns

    def _log(self, level: Level, text: str) -> None:
        print(f"[{_LEVELS[level]}] [{time.time():.3f}] [{self._arguments.node}]: {text}", file=sys.stderr, flush=True)

    def _on_mismatch(self, what: str, topic: str, problem: str) -> None:
        self._refuse(f"{what} of {topic[2:]}", problem)

    def _on_clock(self, data: bytes, publisher: str) -> None:
        try:
            clock = self._encoder.decode("rosgraph_msgs/Clock", data).clock
        except MessageError as error:
            self._refuse("message", f"{self.resolve('/clock')}: {error}")
        else:
            self._clock_ns = clock.sec * 1_000_000_000 + clock.nanosec


def _is_local(environment: Mapping[str, str]) -> bool:
    """Whether ROS's environment variables (Humble; Jazzy) restrict it to this machine."""
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return environment.get("ROS_LOCALHOST_ONLY") == "1" or reach == "LOCALHOST"


def _static_peers(environment: Mapping[str, str]) -> list[str]:
    """Addresses in ROS_STATIC_PEERS, which are separated by semicolons; those of names are looked up."""
    found = []
    for name in filter(None, map(str.strip, environment.get("ROS_STATIC_PEERS", "").split(";"))):
        try:
            found.append(socket.gethostbyname(name))
        except OSError as error:
            raise ConfigurationError(f"ROS_STATIC_PEERS: {name}: {error.strerror or error}") from None
    return found


def run_dds(
    arguments: Sequence[str] = (),
    *,
    given: Mapping[str, Any] | None = None,
    interfaces: Sequence[str] = (),
    open_viewers: ViewerOpener = nullcontext,
    on_poll: Callable[[], None] = lambda: None,
) -> None:
    """Run the node until Ctrl-C, then write the results to `out`.

    Parameters
    ----------
    arguments : sequence of str
        ROS arguments, see `parse_ros_arguments`.
    given : mapping, optional
        Parameters that override the arguments.
    interfaces : sequence of str
        Network interfaces by address or name; if empty, ROS's environment variables or the library choose them.
    open_viewers : callable
        Called with the core before it starts: see `gridslam.ros.node.transport.ViewerOpener`.
    on_poll : callable
        Called several times a second; may raise KeyboardInterrupt.

    Raises
    ------
    ConfigurationError
        No port or interface is there, or an argument or parameter is invalid.
    """
    ros = parse_ros_arguments(arguments)
    values = {**ros.parameters, **(given or {})}
    simulated = values.pop("use_sim_time", False) is True
    parameters = node_parameters(values, "default")
    try:
        domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    except ValueError:
        raise ConfigurationError("ROS_DOMAIN_ID: expected a number, got " + os.environ["ROS_DOMAIN_ID"]) from None
    where = interfaces or (["127.0.0.1"] if _is_local(os.environ) else [])
    peers = _static_peers(os.environ)
    transport = DdsTransport(ros, domain=domain, interfaces=where, simulated=simulated, peers=peers)
    node = RosNode(transport, parameters)
    if parameters.lifecycle:
        node.core.pause(True)
        transport.advertise_lifecycle(node.core)
    node.run(open_viewers, on_poll)
