"""The node in ROS 2 by rclpy, which a sourced ROS 2 provides.

Scans, transforms and published messages pass through rclpy as bytes: no message becomes a Python object on its way.
With the parameter `lifecycle` it is a managed node: it maps while it is active, pauses when it is deactivated, and
forgets when it is cleaned up.
"""

from __future__ import annotations

import array
import importlib
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
from gridslam.ros.ros2.outputs import LATCHED, TOPICS, Ros2Outputs

__all__ = ["NODE_NAME", "Ros2Node", "run_ros2"]

NODE_NAME = "gridslam"

_POLL_S = 0.2
_ROS_S = ("use_sim_time", "start_type_description_service", "lifecycle")
"""Parameters that rclpy handles, or that are read before the node is created."""


def _module(name: str) -> Any:  # noqa: ANN401
    try:
        return importlib.import_module(name)
    except ImportError as error:
        hint = "source a ROS 2's setup.bash, or use --transport dds"
        raise ConfigurationError(f"ROS 2 is not available ({error}): {hint}") from None


def _type(name: str, folder: str = "msg") -> Any:  # noqa: ANN401
    package, _, kind = name.partition("/")
    return getattr(_module(f"{package}.{folder}"), kind)


@final
class Ros2Node:
    """Publishers, subscriptions and services on a node of rclpy.

    Parameters
    ----------
    node : rclpy.node.Node
        Or a managed node.
    parameters : NodeParameters
        Settings and configuration from the node's parameters.
    """

    def __init__(self, node: Any, parameters: NodeParameters) -> None:  # noqa: ANN401
        self._node, self._qos, self._is_ok = node, _module("rclpy.qos"), _module("rclpy").ok
        self._out = parameters.out or Path("gridslam-map")
        self._publishers = {
            topic: node.create_publisher(
                _type(kind), topic, self._profile(latched=topic in LATCHED, depth=1 if topic in LATCHED else 10)
            )
            for topic, kind in TOPICS.items()
        }
        outputs = Ros2Outputs(self._publish, self._now_ns, self.log, node.get_name())
        self.core = NodeCore(parameters.settings, parameters.configuration, outputs, record=parameters.record)
        if parameters.warning:
            self.log(Level.WARN, parameters.warning)

    def start(self) -> None:
        """Start the core, services and subscriptions."""
        self.core.start()
        self._advertise_services()
        self._subscribe()
        self.log(Level.OK, describe_topics(self._node.resolve_topic_name("scan"), self.core))

    def log(self, level: Level, text: str) -> None:
        """Log to the console and /rosout; rclpy requires one severity per line of code."""
        logger = self._node.get_logger()
        if level is Level.OK:
            logger.info(text)
        elif level is Level.WARN:
            logger.warning(text)
        else:
            logger.error(text)

    def _publish(self, topic: str, data: bytes) -> None:
        if self._is_ok():
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

    def _subscribe(self) -> None:
        node, sensor = self._node, self._node.resolve_topic_name("scan")

        def on_scan(data: bytes) -> None:
            self.core.on_scan(decode_scan(data, wire_of_cdr(data)), sensor)

        def on_transforms(static: bool) -> Callable[[bytes], None]:
            return lambda data: self.core.on_transforms(decode_transforms(data, wire_of_cdr(data)), static=static)

        def on_pose(data: bytes) -> None:
            set_pose_from_message(self.core, data, wire_of_cdr(data))

        if self.core.localizes:
            kind, on_message = (
                _type("geometry_msgs/PoseWithCovarianceStamped"),
                self._make_callback("initialpose", on_pose),
            )
            node.create_subscription(kind, "initialpose", on_message, self._profile(depth=1), raw=True)
        for topic, kind, handle, profile in (
            ("/tf_static", "tf2_msgs/TFMessage", on_transforms(True), self._profile(latched=True, depth=100)),
            ("/tf", "tf2_msgs/TFMessage", on_transforms(False), self._profile(depth=100)),
            ("scan", "sensor_msgs/LaserScan", on_scan, self._profile(reliable=False, depth=5)),
        ):
            node.create_subscription(_type(kind), topic, self._make_callback(topic, handle), profile, raw=True)

    def _make_callback(self, topic: str, handle: Callable[[bytes], None]) -> Callable[[bytes], None]:
        """Call back, and warn of bytes that are not a valid message."""

        def on_message(data: bytes) -> None:
            try:
                handle(data)
            except MessageError as error:
                self.core.refuse_message("message", f"{topic}: {error}")

        return on_message

    def _advertise_services(self) -> None:
        core, node = self.core, self._node

        def dynamic_map(request: Any, response: Any) -> Any:  # noqa: ANN401
            latest = core.dynamic_map()
            if latest is not None:
                grid = response.map
                height, width = latest.cells.shape
                stamp = grid.header.stamp.sec, grid.header.stamp.nanosec = divmod(latest.stamp_ns, 1_000_000_000)
                grid.header.frame_id = latest.frame
                grid.info.map_load_time.sec, grid.info.map_load_time.nanosec = stamp
                grid.info.resolution, grid.info.width, grid.info.height = latest.resolution_m, width, height
                grid.info.origin.position.x, grid.info.origin.position.y = latest.origin
                grid.info.origin.orientation.w = 1.0
                grid.data = array.array("b", latest.cells.tobytes())
            return response

        def reset(request: Any, response: Any) -> Any:  # noqa: ANN401
            core.reset()
            return response

        def pause(request: Any, response: Any) -> Any:  # noqa: ANN401
            core.pause(request.data)
            response.success, response.message = True, "paused" if request.data else "mapping"
            return response

        def save(request: Any, response: Any) -> Any:  # noqa: ANN401
            response.success, response.message = save_results(core, self._out)
            return response

        # A slow service must not block the scans.
        apart = _module("rclpy.callback_groups").MutuallyExclusiveCallbackGroup()
        node.create_service(_type("nav_msgs/GetMap", "srv"), "dynamic_map", dynamic_map)
        for name in ("~/reset", "reinitialize_global_localization")[: 1 + core.localizes]:
            node.create_service(_type("std_srvs/Empty", "srv"), name, reset)
        node.create_service(_type("std_srvs/SetBool", "srv"), "~/pause", pause)
        node.create_service(_type("std_srvs/Trigger", "srv"), "~/save", save, callback_group=apart)


def _read_parameters(node: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return the parameters set by launch files and arguments; no others are declared, so presets apply."""
    there = node.get_parameters_by_prefix("")
    return {name: held.value for name, held in there.items() if name not in _ROS_S and "." not in name}


def _make_managed_class(base: Any) -> Any:  # noqa: ANN401
    """Return a node class whose transitions pause and reset the core."""
    done = _module("rclpy.lifecycle").TransitionCallbackReturn.SUCCESS

    class Managed(base):  # type: ignore[misc]
        core: NodeCore | None = None

        def on_configure(self, state: Any) -> Any:  # noqa: ANN401
            return done

        def on_activate(self, state: Any) -> Any:  # noqa: ANN401
            if self.core is not None:
                self.core.pause(False)
            return super().on_activate(state)

        def on_deactivate(self, state: Any) -> Any:  # noqa: ANN401
            if self.core is not None:
                self.core.pause(True)
            return super().on_deactivate(state)

        def on_shutdown(self, state: Any) -> Any:  # noqa: ANN401
            if self.core is not None:
                self.core.pause(True)
            return super().on_shutdown(state)

        def on_cleanup(self, state: Any) -> Any:  # noqa: ANN401
            if self.core is not None:
                self.core.reset()
            return done

    return Managed


def _init_rclpy(rclpy: Any, arguments: list[str]) -> None:  # noqa: ANN401
    """Initialize rclpy, whose signal handlers would end it before the last map is published."""
    unknown = _module("rclpy.utilities").remove_ros_args(arguments)[1:]
    if unknown:
        raise ConfigurationError(f"expected ROS's arguments, after --ros-args, got {' '.join(unknown)}")
    rclpy.init(args=arguments, signal_handler_options=_module("rclpy.signals").SignalHandlerOptions.NO)


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
        Called with the core before it starts: see `gridslam.ros.node.services.ViewerOpener`.
    on_poll : callable
        Called several times a second; may raise KeyboardInterrupt.

    Raises
    ------
    ConfigurationError
        ROS 2 is not available, or a parameter is invalid.
    """
    rclpy = _module("rclpy")
    _init_rclpy(rclpy, ["gridslam", *arguments])
    options = {"allow_undeclared_parameters": True, "automatically_declare_parameters_from_overrides": True}
    node = _module("rclpy.node").Node(NODE_NAME, **options)
    managed = node.has_parameter("lifecycle") and node.get_parameter("lifecycle").value is True
    if managed:
        node.destroy_node()
        node = _make_managed_class(_module("rclpy.lifecycle").LifecycleNode)(NODE_NAME, **options)
    parameters = node_parameters({**_read_parameters(node), **(given or {})}, "default")
    check_folder(parameters.out)
    ours = Ros2Node(node, parameters)
    if managed:
        node.core = ours.core
        ours.core.pause(True)
    executors = _module("rclpy.executors")
    executor = executors.MultiThreadedExecutor(2)
    executor.add_node(node)
    with open_viewers(ours.core):
        try:
            ours.start()
            while rclpy.ok() and not ours.core.ended.is_set():
                executor.spin_once(timeout_sec=_POLL_S)
                on_poll()
        except (KeyboardInterrupt, executors.ExternalShutdownException):  # the usual end of a node
            pass
        finally:
            close_node(ours.core, parameters.out, ours.log)
            node.destroy_node()
            rclpy.try_shutdown()
    if ours.core.failure is not None:
        raise GridslamError(f"the filter failed: {ours.core.failure}") from ours.core.failure
