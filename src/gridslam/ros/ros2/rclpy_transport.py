"""The node in ROS 2 by rclpy, which a sourced ROS 2 provides.

Scans, transforms and published messages pass through rclpy as bytes: no message becomes a Python object on its way.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, final

from gridslam.errors import ConfigurationError
from gridslam.io.bags.encoder import MessageEncoder
from gridslam.pipeline import describe_error
from gridslam.ros.node.messages import Level, Outputs
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.node.transport import LATCHED, NO_OPTIONS, POLL_S, TOPICS, Handler, RunOptions, Serve, import_ros
from gridslam.ros.ros2.parameter_files import find_foreign_files

NODE_NAME = "gridslam"

_HINT = "source a ROS 2, and install gridslam with its Python (python3 -m venv --system-site-packages)"
_import = partial(import_ros, "ROS 2", _HINT)


@final
class RclpyTransport:
    """Publishers, subscriptions and services on a node of rclpy.

    A thread of its own runs the executor: a signal interrupts the main thread, and never a callback.
    """

    global_localization = "reinitialize_global_localization"

    def __init__(self, node: Any) -> None:  # noqa: ANN401
        self._node = node
        self._rclpy = _import("rclpy")
        self._qos = _import("rclpy.qos")
        kinds = self._qos.QoSPolicyKind
        policies = kinds.HISTORY, kinds.DEPTH, kinds.RELIABILITY, kinds.DURABILITY
        self._overrides = _import("rclpy.qos_overriding_options").QoSOverridingOptions(policies)
        self._deserialize = _import("rclpy.serialization").deserialize_message
        self._publishers: dict[str, Any] = {}
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()
        self.encoder = MessageEncoder(is_ros1=False)
        self.outputs: Outputs = EncodedOutputs(
            self.encoder, self._publish, self._now_ns, self._log, self._node.get_name()
        )

    def connect(self, refuse: Callable[[str, str], None], topics: Mapping[str, str]) -> None:
        """Create the publishers; `refuse` is called with kind and problem of what cannot be received."""
        self._refuse = refuse
        for topic, kind in topics.items():
            self._add_publisher(topic, kind)
        self.outputs.topics = tuple(self._publishers)

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic, after remapping."""
        return str(self._node.resolve_topic_name(topic))

    def subscribe(
        self, topic: str, kind: str, handle: Handler, *, reliable: bool = True, latched: bool = False, depth: int = 10
    ) -> None:
        """Subscribe to the bytes of messages."""
        profile = self._profile(reliable=reliable, latched=latched, depth=depth)
        options = {"raw": True, "qos_overriding_options": self._overrides}
        self._node.create_subscription(_import(kind), topic, handle, profile, **options)

    def advertise(self, service: str, kind: str, serve: Serve, *, slow: bool = False) -> None:
        """Offer a service.

        To the executor a slow one gives the rest of its work instead of a response, which a thread does and sends.
        """
        service_class = _import(kind, "srv")

        def answer(request: Any, response: Any) -> Any:  # noqa: ANN401
            try:
                answered = serve(request)
                if isinstance(answered, bytes):
                    return self._deserialize(answered, service_class.Response)
                for name, value in zip(response.get_fields_and_field_types(), answered or (), strict=False):
                    setattr(response, name, value)
            except Exception as error:  # the executor goes on, whatever was asked
                self._refuse("request", f"{self.resolve(service)}: {describe_error(error)}")
            return response

        offered = self._node.create_service(service_class, service, partial(partial, answer) if slow else answer)
        send = offered.send_response

        def start(work: Callable[[], Any], header: Any) -> None:  # noqa: ANN401
            def finish() -> None:
                response = work()
                if self._rclpy.ok():
                    send(response, header)

            threading.Thread(target=finish, name="gridslam-service", daemon=True).start()

        if slow:
            offered.send_response = start

    def spin(self, ended: threading.Event) -> Iterator[None]:
        """Deliver messages until ROS is shut down or the event is set."""
        self._thread = threading.Thread(target=self._execute, name="gridslam-rclpy", daemon=True)
        self._thread.start()
        while self._rclpy.ok() and not ended.wait(POLL_S):
            yield

    def close(self) -> None:
        """Shut down."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join()
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def _execute(self) -> None:
        """Run callbacks until the transport is closed: by events where rclpy can, from Jazzy on.

        Executors that wait on sets of all entities take twice as long for each message.
        """
        executors = _import("rclpy.executors")
        try:
            executor = _import("rclpy.experimental").EventsExecutor()
        except ConfigurationError:
            executor = executors.SingleThreadedExecutor()
        executor.add_node(self._node)
        while self._rclpy.ok() and not self._closed.is_set():
            try:
                executor.spin_once(timeout_sec=POLL_S)
            except executors.ExternalShutdownException:
                break
            except Exception as error:
                self._refuse("callback", describe_error(error))
        executor.shutdown()

    def _add_publisher(self, topic: str, kind: str) -> None:
        """Create a publisher, unless it is one of a package that may be missing."""
        try:
            message = _import(kind)
        except ConfigurationError as error:
            if topic in TOPICS:
                raise
            self._log(Level.WARN, f"{topic} is not published: {error}")
            return
        latched = topic in LATCHED
        profile = self._profile(latched=latched, depth=1 if latched else 10)
        options = {"qos_overriding_options": self._overrides}
        self._publishers[topic] = self._node.create_publisher(message, topic, profile, **options)

    def _publish(self, topic: str, data: bytes) -> None:
        if self._rclpy.ok() and topic in self._publishers:
            self._publishers[topic].publish(data)

    def _now_ns(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _log(self, level: Level, text: str) -> None:
        """Log to the console and /rosout; rclpy requires one severity per line of code."""
        logger = self._node.get_logger()
        if level is Level.OK:
            logger.info(text)
        elif level is Level.WARN:
            logger.warning(text)
        else:
            logger.error(text)

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
    there = node.get_parameters_by_prefix("").items()
    return {name: one.value for name, one in there if not _is_of_rclpy(name)}


def _is_of_rclpy(name: str) -> bool:
    """Return whether rclpy handles a parameter itself; QoS overrides of topics it declares as read-only."""
    return name in {"use_sim_time", "start_type_description_service"} or name.startswith("qos_overrides.")


def _refuse_changes(parameters: Sequence[Any]) -> Any:  # noqa: ANN401
    """Refuse changes of the node's own parameters, which are read when it starts."""
    refused = ", ".join(one.name for one in parameters if not _is_of_rclpy(one.name))
    reason = f"{refused}: read when the node starts" if refused else ""
    return _import("rcl_interfaces.msg").SetParametersResult(successful=not refused, reason=reason)


def _init_rclpy(rclpy: Any, arguments: list[str]) -> None:  # noqa: ANN401
    """Initialize rclpy, whose signal handlers would end it before the last map is published."""
    unknown = _import("rclpy.utilities").remove_ros_args(arguments)[1:]
    if unknown:
        raise ConfigurationError(f"expected ROS's arguments, after --ros-args, got {' '.join(unknown)}")
    rclpy.init(args=arguments, signal_handler_options=_import("rclpy.signals").SignalHandlerOptions.NO)


def run_rclpy(arguments: Sequence[str] = (), options: RunOptions = NO_OPTIONS) -> None:
    """Run the node until ROS or Ctrl-C shuts it down, then write the results to `out`.

    Parameters
    ----------
    arguments : sequence of str
        ROS arguments: ``--ros-args -p particles:=80 -r scan:=front/scan --params-file robot.yaml``.
    options : RunOptions
        Parameters and viewers.

    Raises
    ------
    ConfigurationError
        ROS 2 is not available, or an argument or parameter is invalid.
    """
    _init_rclpy(_import("rclpy"), ["gridslam", *arguments])
    node = _import("rclpy.node").Node(NODE_NAME, automatically_declare_parameters_from_overrides=True)
    parameters = node_parameters({**_read_parameters(node), **options.given}, "default")
    node.add_on_set_parameters_callback(_refuse_changes)
    transport = RclpyTransport(node)
    for sentence in find_foreign_files(arguments, node.get_fully_qualified_name()):
        transport.outputs.log(Level.WARN, sentence)
    RosNode(transport, parameters).run(options)
