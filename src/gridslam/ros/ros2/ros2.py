"""The node in ROS 2 by rclpy, which a sourced ROS 2 provides.

Scans, transforms and published messages pass through rclpy as bytes: no message becomes a Python object on its way.
With the parameter `lifecycle` it is a managed node: it maps while it is active, pauses when it is deactivated, and
forgets when it is cleaned up.
"""

from __future__ import annotations

import array
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from functools import partial
from typing import Any, final

from gridslam.errors import ConfigurationError
from gridslam.io.bags.encoder import MessageEncoder
from gridslam.io.bags.ros_messages import Wire, wire_of_cdr
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.messages import GridMessage, Level, Outputs
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.transport import (
    LATCHED,
    POLL_S,
    TOPICS,
    Handler,
    RosNode,
    TypedService,
    ViewerOpener,
    import_ros,
)
from gridslam.ros.ros2.arguments import find_foreign_files

__all__ = ["NODE_NAME", "Ros2Transport", "run_ros2"]

NODE_NAME = "gridslam"

_ROS_S = ("use_sim_time", "start_type_description_service")
"""Parameters that rclpy handles, or that are read before the node is created."""


_import = partial(import_ros, "ROS 2", "source a ROS 2's setup.bash, or use --transport dds")


@final
class Ros2Transport:
    """Publishers, subscriptions and services on a node of rclpy, which may be a managed one."""

    global_localization = "reinitialize_global_localization"

    def __init__(self, node: Any) -> None:  # noqa: ANN401
        self._node = node
        self._rclpy = _import("rclpy")
        self._qos = _import("rclpy.qos")
        kinds = self._qos.QoSPolicyKind
        policies = kinds.HISTORY, kinds.DEPTH, kinds.RELIABILITY, kinds.DURABILITY
        self._overrides = _import("rclpy.qos_overriding_options").QoSOverridingOptions(policies)
        self._apart = _import("rclpy.callback_groups").MutuallyExclusiveCallbackGroup()
        self._publishers: dict[str, Any] = {}
        self._stores = False
        encoder = MessageEncoder(is_ros1=False)
        self.outputs: Outputs = EncodedOutputs(encoder, self._publish, self._now_ns, self._log, node.get_name())

    def connect(self, refuse: Callable[[str, str], None], topics: Mapping[str, str] = TOPICS) -> None:
        """Create the publishers, but for types that are not installed; rclpy itself refuses what cannot be received."""
        for topic, kind in topics.items():
            latched = topic in LATCHED
            profile = self._profile(latched=latched, depth=1 if latched else 10)
            try:
                message = _import(kind)
            except ConfigurationError as error:
                if topic in TOPICS:
                    raise
                self._log(Level.WARN, f"{topic} is not published: {error}")
                continue
            overrides = {"qos_overriding_options": self._overrides}
            self._publishers[topic] = self._node.create_publisher(message, topic, profile, **overrides)
        self.outputs.topics = tuple(self._publishers)

    def wire_of(self, data: bytes) -> Wire:
        """Return the encoding of a message; raises MessageError if it has none."""
        return wire_of_cdr(data)

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic, after remapping."""
        return str(self._node.resolve_topic_name(topic))

    def subscribe(
        self, topic: str, kind: str, handle: Handler, *, reliable: bool = True, latched: bool = False, depth: int = 10
    ) -> None:
        """Subscribe to the bytes of messages; rclpy does not name their publisher."""
        profile = self._profile(reliable=reliable, latched=latched, depth=depth)
        options = {"raw": True, "qos_overriding_options": self._overrides}
        self._node.create_subscription(_import(kind), topic, lambda data: handle(data, ""), profile, **options)

    def advertise(self, service: str, kind: str, serve: Callable[[Any], Sequence[Any]], *, slow: bool = False) -> None:
        """Offer a service of std_srvs; scans do not wait for a slow one."""

        def answer(request: Any, response: Any) -> Any:  # noqa: ANN401
            for name, value in zip(("success", "message"), serve(getattr(request, "data", None)), strict=False):
                setattr(response, name, value)
            return response

        group = {"callback_group": self._apart} if slow else {}
        self._node.create_service(_import(kind, "srv"), service, answer, **group)

    def advertise_typed(self, package: str, services: Mapping[str, TypedService]) -> bool:
        """Offer services of a package's own types; what a version of them does not have is left out."""

        def offer(name: str, kind: str, serve: Callable[[Any], Mapping[str, Any]]) -> None:
            def answer(request: Any, response: Any) -> Any:  # noqa: ANN401
                for field, value in serve(request).items():
                    if hasattr(response, field):
                        setattr(response, field, value)
                return response

            self._node.create_service(
                _import(f"{package}/{kind}", "srv"), f"{package}/{name}", answer, callback_group=self._apart
            )

        offered = False
        for name, (kind, serve) in services.items():
            with suppress(ConfigurationError, AttributeError):  # not installed, or not in that version
                offer(name, kind, serve)
                offered = True
        return offered

    def advertise_map(self, service: str, serve: Callable[[], GridMessage | None]) -> None:
        """Offer the map by a service; without a map the response is empty."""

        def answer(request: Any, response: Any) -> Any:  # noqa: ANN401
            latest = serve()
            if latest is not None:
                grid = response.map
                stamp = divmod(latest.stamp_ns, 1_000_000_000)
                grid.header.stamp.sec, grid.header.stamp.nanosec = stamp
                grid.header.frame_id = latest.frame
                grid.info.map_load_time.sec, grid.info.map_load_time.nanosec = stamp
                grid.info.resolution = latest.resolution_m
                grid.info.height, grid.info.width = latest.cells.shape
                grid.info.origin.position.x, grid.info.origin.position.y = latest.origin
                grid.info.origin.orientation.w = 1.0
                grid.data = array.array("b", latest.cells.tobytes())
            return response

        self._node.create_service(_import("nav_msgs/GetMap", "srv"), service, answer)

    def advertise_set_map(self, service: str, serve: Callable[[Any], bool]) -> None:
        """Offer a service of nav_msgs/SetMap."""

        def answer(request: Any, response: Any) -> Any:  # noqa: ANN401
            response.success = serve(request)
            return response

        self._node.create_service(_import("nav_msgs/SetMap", "srv"), service, answer, callback_group=self._apart)

    def save_parameters(self, values: Mapping[str, float]) -> None:
        """Set parameters of the node."""
        make = _import("rclpy.parameter").Parameter
        self._stores = True
        self._node.set_parameters([make(name, value=value) for name, value in values.items()])
        self._stores = False

    def advertise_parameters(
        self, values: Mapping[str, Any], change: Callable[[str, Any], str], settable: Sequence[str]
    ) -> None:
        """Declare the parameters, and refuse to set those that are read at the start."""
        result_class = _import("rcl_interfaces/SetParametersResult")

        def on_set(parameters: Sequence[Any]) -> Any:  # noqa: ANN401
            problems = []
            for name, value in ((one.name, one.value) for one in parameters):
                if name in settable:
                    problems.append(change(name, value))
                elif name in values and not self._stores:
                    problems.append(f"{name} is read when the node starts: start it with -p {name}:=VALUE")
            problem = next(filter(None, problems), "")
            return result_class(successful=not problem, reason=problem)

        for name, value in values.items():
            if not self._node.has_parameter(name):
                self._node.declare_parameter(name, value)
        self._node.add_on_set_parameters_callback(on_set)

    def spin(self, ended: threading.Event) -> Iterator[None]:
        """Deliver messages until ROS is shut down or the event is set."""
        executors = _import("rclpy.executors")
        executor = executors.MultiThreadedExecutor(2)
        executor.add_node(self._node)
        while self._rclpy.ok() and not ended.is_set():
            try:
                executor.spin_once(timeout_sec=POLL_S)
            except executors.ExternalShutdownException:
                return
            yield

    def close(self) -> None:
        """Shut down."""
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def _log(self, level: Level, text: str) -> None:
        """Log to the console and /rosout; rclpy requires one severity per line of code."""
        logger = self._node.get_logger()
        if level is Level.OK:
            logger.info(text)
        elif level is Level.WARN:
            logger.warning(text)
        else:
            logger.error(text)

    def _publish(self, topic: str, data: bytes) -> None:
        if self._rclpy.ok() and topic in self._publishers:
            self._publishers[topic].publish(data)

    def _now_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _profile(self, *, reliable: bool = True, latched: bool = False, depth: int) -> Any:  # noqa: ANN401
        qos = self._qos
        return qos.QoSProfile(
            history=qos.HistoryPolicy.KEEP_LAST,
            depth=depth,
            reliability=qos.ReliabilityPolicy.RELIABLE if reliable else qos.ReliabilityPolicy.BEST_EFFORT,
            durability=qos.DurabilityPolicy.TRANSIENT_LOCAL if latched else qos.DurabilityPolicy.VOLATILE,
        )


def _read_parameters(node: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the parameters set by launch files and arguments; no others are declared, so presets apply."""
    there = node.get_parameters_by_prefix("")
    return {
        name: held.value for name, held in there.items() if name not in _ROS_S and not name.startswith("qos_overrides.")
    }


def _make_managed_class(base: Any) -> Any:  # noqa: ANN401
    """Return a node class whose transitions pause and reset the core, which is set before the node spins."""

    class Managed(base):  # type: ignore[misc]
        core: NodeCore

        def on_activate(self, state: Any) -> Any:  # noqa: ANN401
            self.core.pause(False)
            return super().on_activate(state)

        def on_deactivate(self, state: Any) -> Any:  # noqa: ANN401
            self.core.pause(True)
            return super().on_deactivate(state)

        def on_shutdown(self, state: Any) -> Any:  # noqa: ANN401
            self.core.pause(True)
            return super().on_shutdown(state)

        def on_cleanup(self, state: Any) -> Any:  # noqa: ANN401
            self.core.reset()
            return super().on_cleanup(state)

    return Managed


def _init_rclpy(rclpy: Any, arguments: list[str]) -> None:  # noqa: ANN401
    """Initialize rclpy, whose signal handlers would end it before the last map is published."""
    unknown = _import("rclpy.utilities").remove_ros_args(arguments)[1:]
    if unknown:
        raise ConfigurationError(f"expected ROS's arguments, after --ros-args, got {' '.join(unknown)}")
    rclpy.init(args=arguments, signal_handler_options=_import("rclpy.signals").SignalHandlerOptions.NO)


def run_ros2(
    arguments: Sequence[str] = (),
    *,
    given: Mapping[str, Any] | None = None,
    open_viewers: ViewerOpener = nullcontext,
    on_poll: Callable[[], None] = lambda: None,
) -> None:
    """Run the node until ROS or Ctrl-C shuts it down, then write the results to `out`.

    Parameters
    ----------
    arguments : sequence of str
        ROS arguments: ``--ros-args -p particles:=80 -r scan:=front/scan --params-file robot.yaml``.
    given : mapping, optional
        Parameters that override those of ROS.
    open_viewers : callable
        Called with the core before it starts: see `gridslam.ros.node.transport.ViewerOpener`.
    on_poll : callable
        Called several times a second; may raise KeyboardInterrupt.

    Raises
    ------
    ConfigurationError
        ROS 2 is not available, or a parameter is invalid.
    """
    _init_rclpy(_import("rclpy"), ["gridslam", *arguments])
    options = {"allow_undeclared_parameters": True, "automatically_declare_parameters_from_overrides": True}
    node = _import("rclpy.node").Node(NODE_NAME, **options)
    managed = node.has_parameter("lifecycle") and node.get_parameter("lifecycle").value is True
    if managed:
        node.destroy_node()
        node = _make_managed_class(_import("rclpy.lifecycle").LifecycleNode)(NODE_NAME, **options)
    parameters = node_parameters({**_read_parameters(node), **(given or {})}, "default")
    transport = Ros2Transport(node)
    for sentence in find_foreign_files(arguments, node.get_fully_qualified_name()):
        transport.outputs.log(Level.WARN, sentence)
    ours = RosNode(transport, parameters)
    if managed:
        node.core = ours.core
        ours.core.pause(True)
    ours.run(open_viewers, on_poll)
