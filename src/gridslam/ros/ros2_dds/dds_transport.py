"""The node in ROS 2 without ROS: by RTPS, as `ros2 node`, `ros2 topic`, `ros2 service` and `ros2 param` expect it."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Final, final

from gridslam.errors import ConfigurationError
from gridslam.io.bags.ros_messages import MessageError
from gridslam.ros.node.messages import Level
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.transport import NO_OPTIONS, POLL_S, Handler, RunOptions, Serve
from gridslam.ros.ros2.arguments import RosArguments, parse_ros_arguments
from gridslam.ros.ros2.transport import Ros2Transport
from gridslam.ros.ros2_dds.endpoints import Ros2Endpoints
from gridslam.ros.rtps.participant import Participant
from gridslam.ros.rtps.qos import Qos
from gridslam.ros.rtps.writer import Writer

_ROSOUT, _LOG, _LOG_DEPTH = "/rosout", "rcl_interfaces/Log", 1000
_LEVELS: Final = {Level.OK: (20, "INFO"), Level.WARN: (30, "WARN"), Level.ERROR: (40, "ERROR")}
"""Numbers of rcl_interfaces/Log, and names."""


@final
class DdsTransport(Ros2Transport):
    """Writers, readers and services of the node.

    Parameters
    ----------
    arguments : RosArguments
        Names and remappings.
    simulated : bool
        Whether to use the time of /clock.
    domain, interfaces, peers
        As of `Participant`.
    """

    def __init__(
        self,
        arguments: RosArguments,
        *,
        domain: int = 0,
        interfaces: Sequence[str] = (),
        simulated: bool = False,
        peers: Sequence[str] = (),
    ) -> None:
        node = arguments.namespace, arguments.node
        super().__init__(f"{node[0].rstrip('/')}/{node[1]}", simulated=simulated)
        self._arguments = arguments
        self._clock_ns = 0
        self._listens_to_clock = False
        self._participant = Participant(domain, interfaces, arguments.node, self._on_mismatch, peers)
        self._endpoints = Ros2Endpoints(self._participant, node, self.encoder)
        self._writers: dict[str, Writer] = {}
        self._add_publisher(_ROSOUT, _LOG, latched=True, depth=_LOG_DEPTH)
        if arguments.ignored:
            self._log(Level.WARN, f"arguments that are ignored, as there is no ROS: {', '.join(arguments.ignored)}")
        self._use_sim_time(simulated)

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic, after remapping."""
        return self._arguments.resolve(topic)

    def subscribe(
        self, topic: str, kind: str, handle: Handler, *, reliable: bool = True, latched: bool = False, depth: int = 10
    ) -> None:
        """Subscribe to the bytes of messages."""
        qos = Qos(reliable=reliable, latched=latched, depth=depth)
        self._endpoints.add_reader(f"rt{self.resolve(topic)}", kind, handle, qos)

    def advertise(self, service: str, kind: str, serve: Serve, *, slow: bool = False) -> None:
        """Offer a service; a slow one answers in a thread of its own."""
        refuse = partial(self._refuse_request, service)
        self._endpoints.add_service(self.resolve(service), kind, serve, refuse, slow=slow)

    def spin(self, ended: threading.Event) -> Iterator[str]:
        """Deliver messages until the event is set."""
        self._participant.start()
        while not ended.wait(POLL_S):
            yield ""

    def close(self) -> None:
        """Shut down."""
        self._participant.close()

    def _add_publisher(self, topic: str, kind: str, *, latched: bool, depth: int) -> bool:
        qos = Qos(latched=latched, depth=depth)
        self._writers[topic] = self._endpoints.add_writer(f"rt{self.resolve(topic)}", kind, qos)
        return True

    def _use_sim_time(self, simulated: bool) -> None:
        self._simulated = simulated
        if simulated and not self._listens_to_clock:
            self._listens_to_clock = True
            self.subscribe("/clock", "rosgraph_msgs/Clock", self._on_clock, reliable=False, depth=1)

    def _publish(self, topic: str, data: bytes) -> None:
        if topic in self._writers:
            self._participant.write(self._writers[topic], data)

    def _now_ns(self) -> int:
        return self._clock_ns if self._simulated else time.time_ns()

    def _log(self, level: Level, text: str) -> None:
        """Log to the console, in one piece, and to /rosout."""
        number, label = _LEVELS[level]
        name = self._name[1:].replace("/", ".")
        sys.stderr.write(f"[{label}] [{time.time():.3f}] [{name}]: {text}\n")
        sys.stderr.flush()
        stamp = divmod(time.time_ns(), 1_000_000_000)
        self._publish(_ROSOUT, self.encoder.encode(_LOG, stamp, number, name, text, "", "", 0))

    def _on_mismatch(self, what: str, topic: str, problem: str) -> None:
        self._refuse(f"{what} of {topic[2:]}", problem)

    def _on_clock(self, data: bytes, publisher: str) -> None:
        try:
            clock = self.encoder.decode("rosgraph_msgs/Clock", data).clock
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


def run_dds(arguments: Sequence[str] = (), options: RunOptions = NO_OPTIONS, interfaces: Sequence[str] = ()) -> None:
    """Run the node until Ctrl-C, then write the results to `out`.

    Parameters
    ----------
    arguments : sequence of str
        ROS arguments, see `parse_ros_arguments`.
    options : RunOptions
        Parameters and viewers.
    interfaces : sequence of str
        Network interfaces by address or name; if empty, ROS's environment variables or the library choose them.

    Raises
    ------
    ConfigurationError
        No port or interface is there, or an argument or parameter is invalid.
    """
    ros = parse_ros_arguments(arguments)
    values = {**ros.parameters, **options.given}
    simulated = values.pop("use_sim_time", False) is True
    parameters = node_parameters(values, "default")
    try:
        domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    except ValueError:
        raise ConfigurationError("ROS_DOMAIN_ID: expected a number, got " + os.environ["ROS_DOMAIN_ID"]) from None
    where = interfaces or (["127.0.0.1"] if _is_local(os.environ) else [])
    peers = _static_peers(os.environ)
    transport = DdsTransport(ros, domain=domain, interfaces=where, simulated=simulated, peers=peers)
    transport.run(arguments, parameters, options)
