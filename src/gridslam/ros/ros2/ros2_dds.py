"""The node in ROS 2 without ROS: topics and services by Cyclone DDS, compatible with `ros2 topic` and rclcpp."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, final

from gridslam.errors import ConfigurationError, GridslamError
from gridslam.io.bags.ros_messages import MessageError, decode_scan, decode_transforms, wire_of_cdr
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.initial_pose import set_pose_from_message
from gridslam.ros.node.messages import Level
from gridslam.ros.node.parameters import NodeParameters, node_parameters
from gridslam.ros.node.services import ViewerOpener, check_folder, close_node, describe_topics, save_results
from gridslam.ros.ros2.arguments import RosArguments, parse_ros_arguments
from gridslam.ros.ros2.cdr import decode_message, encode_message
from gridslam.ros.ros2.dds import DdsParticipant, Handler
from gridslam.ros.ros2.outputs import LATCHED, TOPICS, Ros2Outputs, grid_values

__all__ = ["DdsNode", "run_dds"]

_POLL_S = 0.2
_LEVELS = {Level.OK: "INFO", Level.WARN: "WARN", Level.ERROR: "ERROR"}


@final
class DdsNode:
    """Writers, readers and services of the node.

    The services only answer clients on rmw_cyclonedds: other vendors identify the client elsewhere.

    Parameters
    ----------
    arguments : RosArguments
        Names and remappings.
    parameters : NodeParameters
        Settings and configuration from the node's parameters.
    domain : int
        ROS_DOMAIN_ID.
    interfaces : sequence of str
        Network interfaces; if empty, the library chooses them.
    simulated : bool
        Whether to use the time of /clock.
    """

    def __init__(
        self,
        arguments: RosArguments,
        parameters: NodeParameters,
        *,
        domain: int = 0,
        interfaces: Sequence[str] = (),
        simulated: bool = False,
    ) -> None:
        self._arguments, self._out = arguments, parameters.out or Path("gridslam-map")
        self._clock_ns: int | None = 0 if simulated else None
        self._participant = DdsParticipant(domain, interfaces, self._on_mismatch)
        outputs = Ros2Outputs(self._publish, self._now_ns, self._log, arguments.node)
        self.core = NodeCore(parameters.settings, parameters.configuration, outputs, record=parameters.record)
        if parameters.warning:
            self._log(Level.WARN, parameters.warning)
        if arguments.ignored:
            self._log(Level.WARN, f"arguments that are ignored, as there is no ROS: {', '.join(arguments.ignored)}")
        self._writers = {topic: f"rt{arguments.resolve(topic)}" for topic in TOPICS}
        for topic, kind in TOPICS.items():
            self._participant.add_writer(self._writers[topic], kind, latched=topic in LATCHED)
        self._subscribe()
        self._advertise_services()

    def start(self) -> None:
        """Start the core and the participant."""
        self.core.start()
        self._participant.start()
        self._log(Level.OK, describe_topics(self._arguments.resolve("scan"), self.core))

    def close(self, out: Path | None) -> None:
        """Stop the node, and write its map to `out` if given."""
        try:
            close_node(self.core, out, self._log)
        finally:
            self._participant.close()

    def _publish(self, topic: str, data: bytes) -> None:
        self._participant.publish(self._writers[topic], data)

    def _now_ns(self) -> int:
        return time.time_ns() if self._clock_ns is None else self._clock_ns

    def _log(self, level: Level, text: str) -> None:
        print(f"[{_LEVELS[level]}] [{time.time():.3f}] [{self._arguments.node}]: {text}", file=sys.stderr, flush=True)

    def _on_mismatch(self, what: str, topic: str, problem: str) -> None:
        self.core.refuse_message(f"{what} of {topic[2:]}", problem)

    def _subscribe(self) -> None:
        sensor = self._arguments.resolve("scan")

        def on_scan(data: bytes, sender: str) -> None:
            self.core.on_scan(decode_scan(data, wire_of_cdr(data)), sensor)

        def on_transforms(static: bool) -> Handler:
            def handle(data: bytes, sender: str) -> None:
                found = decode_transforms(data, wire_of_cdr(data))
                self.core.on_transforms(found, static=static, publisher=sender)

            return handle

        def on_clock(data: bytes, sender: str) -> None:
            seconds, nanoseconds = decode_message("rosgraph_msgs/Clock", data)
            self._clock_ns = seconds * 1_000_000_000 + nanoseconds

        def on_pose(data: bytes, sender: str) -> None:
            set_pose_from_message(self.core, data, wire_of_cdr(data))

        if self.core.localizes:
            self._read("initialpose", "geometry_msgs/PoseWithCovarianceStamped", on_pose, depth=1)
        self._read("/tf_static", "tf2_msgs/TFMessage", on_transforms(True), latched=True, depth=100)
        self._read("/tf", "tf2_msgs/TFMessage", on_transforms(False), depth=100)
        self._read("scan", "sensor_msgs/LaserScan", on_scan, reliable=False, depth=10)
        if self._clock_ns is not None:
            self._read("/clock", "rosgraph_msgs/Clock", on_clock, reliable=False, depth=1)

    def _read(self, topic: str, kind: str, handle: Handler, **qos: Any) -> None:  # noqa: ANN401
        name = self._arguments.resolve(topic)

        def on_message(data: bytes, sender: str) -> None:
            try:
                handle(data, sender)
            except (MessageError, ValueError) as error:
                self.core.refuse_message("message", f"{name}: {error}")

        self._participant.add_reader(f"rt{name}", kind, on_message, **qos)

    def _advertise_services(self) -> None:
        core = self.core

        def dynamic_map() -> tuple[Any, ...]:
            latest = core.dynamic_map()
            return (grid_values(latest) if latest is not None else _EMPTY_GRID,)

        def reset() -> tuple[Any, ...]:
            core.reset()
            return (0,)

        def pause(paused: bool) -> tuple[Any, ...]:
            core.pause(paused)
            return True, "paused" if paused else "mapping"

        self._add_service("dynamic_map", "nav_msgs/GetMap", lambda unused: dynamic_map())
        for name in ("~/reset", "reinitialize_global_localization")[: 1 + core.localizes]:
            self._add_service(name, "std_srvs/Empty", lambda unused: reset())
        self._add_service("~/pause", "std_srvs/SetBool", pause)
        self._add_service("~/save", "std_srvs/Trigger", lambda unused: save_results(core, self._out), slow=True)

    def _add_service(
        self, service: str, kind: str, serve: Callable[[Any], tuple[Any, ...]], *, slow: bool = False
    ) -> None:
        """Add a service; a slow one answers in a thread of its own."""
        name = self._arguments.resolve(service)
        reply = f"rr{name}Reply"
        self._participant.add_writer(reply, f"{kind}_Response")

        def answer(guid: int, sequence: int, value: Any) -> None:  # noqa: ANN401
            self._participant.publish(reply, encode_message(f"{kind}_Response", (guid, sequence, *serve(value))))

        def on_request(data: bytes, sender: str) -> None:
            try:
                request = decode_message(f"{kind}_Request", data)
            except ValueError as error:
                self.core.refuse_message("request", f"{name}: {error}")
                return
            if slow:
                threading.Thread(target=answer, args=tuple(request), daemon=True).start()
            else:
                answer(*request)

        self._participant.add_reader(f"rq{name}Request", f"{kind}_Request", on_request)


_EMPTY_GRID = (((0, 0), ""), ((0, 0), 0.0, 0, 0, ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))), b"")


def _is_local(environment: Mapping[str, str]) -> bool:
    """Whether ROS's environment variables (Humble; Jazzy) restrict it to this machine."""
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "").upper()
    return environment.get("ROS_LOCALHOST_ONLY") == "1" or reach == "LOCALHOST"


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
        Called with the core before it starts: see `gridslam.ros.node.services.ViewerOpener`.
    on_poll : callable
        Called several times a second; may raise KeyboardInterrupt.

    Raises
    ------
    ConfigurationError
        Cyclone DDS is not installed, or an argument or parameter is invalid.
    """
    ros = parse_ros_arguments(arguments)
    values = {**ros.parameters, **(given or {})}
    simulated = values.pop("use_sim_time", False) is True
    parameters = node_parameters(values, "default")
    check_folder(parameters.out)
    try:
        domain = int(os.environ.get("ROS_DOMAIN_ID", "0"))
    except ValueError:
        raise ConfigurationError("ROS_DOMAIN_ID: expected a number, got " + os.environ["ROS_DOMAIN_ID"]) from None
    where = interfaces or (["127.0.0.1"] if _is_local(os.environ) else [])
    node = DdsNode(ros, parameters, domain=domain, interfaces=where, simulated=simulated)
    with open_viewers(node.core):
        try:
            node.start()
            while not node.core.ended.wait(_POLL_S):
                on_poll()
        except KeyboardInterrupt:  # the usual end of a node
            pass
        finally:
            node.close(parameters.out)
    if node.core.failure is not None:
        raise GridslamError(f"the filter failed: {node.core.failure}") from node.core.failure
