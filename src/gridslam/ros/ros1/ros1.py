"""The node in ROS 1 by rospy: a drop-in replacement for slam_gmapping.

Scans and transforms are decoded from their bytes, which is fast for large scans and works with any version of NumPy.
The cells of the map are sent without a copy into Python objects.

Source: the interface of slam_gmapping, http://wiki.ros.org/gmapping.
"""

from __future__ import annotations

import importlib
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any, final

from gridslam.errors import ConfigurationError, GridslamError
from gridslam.io.bags.ros_messages import MessageError, decode_scan, decode_transforms, kind_of, wire_of_ros1
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.initial_pose import set_pose_from_message
from gridslam.ros.node.messages import CloudMessage, Diagnostics, GridMessage, Level, PoseMessage, StampedTransform
from gridslam.ros.node.parameters import NodeParameters, node_parameters
from gridslam.ros.node.services import ViewerOpener, check_folder, close_node, describe_topics, save_results
from gridslam.ros.ros1.arguments import check_ros1_arguments
from gridslam.ros.ros1.messages import cloud_class, grid_class, response_class

__all__ = ["NODE_NAME", "Ros1Node", "run_ros1"]

NODE_NAME = "slam_gmapping"

_POLL_S = 0.2


def _modules() -> dict[str, Any]:
    """Import rospy and the message packages; raises ConfigurationError if ROS 1 is not installed."""
    names = (
        "rospy", "std_msgs.msg", "std_srvs.srv", "nav_msgs.msg", "nav_msgs.srv", "geometry_msgs.msg", "tf2_msgs.msg",
        "diagnostic_msgs.msg",
    )  # fmt: skip
    try:
        return {name: importlib.import_module(name) for name in names}
    except ImportError as error:
        hint = "source its setup.bash, or install python3-rospy and the messages' packages"
        raise ConfigurationError(f"ROS 1 is not available ({error}): {hint}") from None


@final
class Ros1Node:
    """Publishers, subscribers and services of the node, after `rospy.init_node`.

    Parameters
    ----------
    parameters : NodeParameters
        Settings and configuration from the node's private parameters.
    """

    def __init__(self, parameters: NodeParameters) -> None:
        self._ros = _modules()
        rospy, nav, std = self._ros["rospy"], self._ros["nav_msgs.msg"], self._ros["std_msgs.msg"]
        self._grid_class = grid_class(nav.OccupancyGrid)
        self._map = rospy.Publisher("map", nav.OccupancyGrid, queue_size=1, latch=True)
        self._metadata = rospy.Publisher("map_metadata", nav.MapMetaData, queue_size=1, latch=True)
        self._entropy = rospy.Publisher("~entropy", std.Float64, queue_size=1, latch=True)
        self._tf = rospy.Publisher("/tf", self._ros["tf2_msgs.msg"].TFMessage, queue_size=100)
        geometry = self._ros["geometry_msgs.msg"]
        self._pose = rospy.Publisher("~pose", geometry.PoseWithCovarianceStamped, queue_size=10)
        self._cloud_class = cloud_class(geometry.PoseArray)
        self._cloud = rospy.Publisher("particlecloud", geometry.PoseArray, queue_size=1)
        diagnostic = self._ros["diagnostic_msgs.msg"]
        self._diagnostics = rospy.Publisher("/diagnostics", diagnostic.DiagnosticArray, queue_size=10)
        self.core = NodeCore(parameters.settings, parameters.configuration, self, record=parameters.record)
        if parameters.warning:
            self.log(Level.WARN, parameters.warning)
        self._out = parameters.out or Path("gridslam-map")

    def start(self) -> None:
        """Start the core, services and subscribers."""
        self.core.start()
        self._advertise_services()
        self._subscribe()
        self.log(Level.OK, describe_topics(self._ros["rospy"].resolve_name("scan"), self.core))

    def now_ns(self) -> int:
        """Return the current time, simulated or not, ns."""
        return int(self._ros["rospy"].Time.now().to_nsec())

    def map(self, message: GridMessage) -> None:
        """Publish the map and its metadata, latched."""
        grid = self._grid(message)
        self._publish(self._metadata, grid.info)
        self._publish(self._map, grid)

    def transform(self, message: StampedTransform) -> None:
        """Publish on /tf."""
        geometry = self._ros["geometry_msgs.msg"]
        sent = geometry.TransformStamped()
        sent.header.stamp, sent.header.frame_id = self._stamp(message.stamp_ns), message.parent
        sent.child_frame_id = message.child
        x, y, z, *xyzw = message.pose
        sent.transform.translation = geometry.Vector3(x, y, z)
        sent.transform.rotation = geometry.Quaternion(*xyzw)
        self._publish(self._tf, self._ros["tf2_msgs.msg"].TFMessage([sent]))

    def pose(self, message: PoseMessage) -> None:
        """Publish on ~pose."""
        sent = self._ros["geometry_msgs.msg"].PoseWithCovarianceStamped()
        sent.header.stamp, sent.header.frame_id = self._stamp(message.stamp_ns), message.frame
        message.fill(sent.pose)
        self._publish(self._pose, sent)

    def entropy(self, nats: float) -> None:
        """Publish on ~entropy."""
        self._publish(self._entropy, self._ros["std_msgs.msg"].Float64(nats))

    def particles(self, message: CloudMessage) -> None:
        """Publish on particlecloud."""
        cloud = self._cloud_class()
        cloud.header.stamp, cloud.header.frame_id = self._stamp(message.stamp_ns), message.frame
        cloud.count, cloud.data = len(message.poses), message.data()
        self._publish(self._cloud, cloud)

    def diagnostics(self, message: Diagnostics) -> None:
        """Publish on /diagnostics."""
        rospy, diagnostic = self._ros["rospy"], self._ros["diagnostic_msgs.msg"]
        values = [diagnostic.KeyValue(name, value) for name, value in message.values.items()]
        name = f"{rospy.get_name().lstrip('/')}: SLAM"
        status = diagnostic.DiagnosticStatus(int(message.level), name, message.summary, "", values)
        sent = diagnostic.DiagnosticArray(status=[status])
        sent.header.stamp = rospy.Time.now()
        self._publish(self._diagnostics, sent)

    def log(self, level: Level, text: str) -> None:
        """Log to the console and /rosout."""
        rospy = self._ros["rospy"]
        {Level.OK: rospy.loginfo, Level.WARN: rospy.logwarn, Level.ERROR: rospy.logerr}[level]("%s", text)
        sys.stdout.flush()  # rospy does not flush

    def _subscribe(self) -> None:
        rospy = self._ros["rospy"]
        large = {"buff_size": 1 << 24, "tcp_nodelay": True}
        sensor = rospy.resolve_name("scan")

        def on_scan(message: Any) -> None:  # noqa: ANN401
            if data := self._bytes(message, "scan", "sensor_msgs/LaserScan"):
                self.core.on_scan(decode_scan(data, wire_of_ros1(data)), sensor)

        def on_transforms(static: bool) -> Callable[[Any], None]:
            def handle(message: Any) -> None:  # noqa: ANN401
                if data := self._bytes(message, "transforms", "tf2_msgs/TFMessage"):
                    sender = message._connection_header.get("callerid", "")
                    found = decode_transforms(data, wire_of_ros1(data))
                    self.core.on_transforms(found, static=static, publisher=sender)

            return handle

        def on_pose(message: Any) -> None:  # noqa: ANN401
            expected, got = "geometry_msgs/PoseWithCovarianceStamped", message._connection_header["type"]
            if got != expected:
                raise MessageError(f"expected {expected}, got {got}")
            set_pose_from_message(self.core, message._buff, wire_of_ros1(message._buff))

        if self.core.localizes:
            rospy.Subscriber("initialpose", rospy.AnyMsg, self._make_callback("initialpose", on_pose), queue_size=1)
        for topic, handle in (("/tf_static", on_transforms(True)), ("/tf", on_transforms(False)), ("scan", on_scan)):
            rospy.Subscriber(topic, rospy.AnyMsg, self._make_callback(topic, handle), queue_size=None, **large)

    def _bytes(self, message: Any, kind: str, expected: str) -> bytes:  # noqa: ANN401
        """Bytes of a message of that kind; none, and a warning, for another one."""
        header: Mapping[str, str] = message._connection_header
        if kind_of(header["type"]) == kind:
            data: bytes = message._buff
            return data
        self.core.refuse_message("message", f"expected {expected} on {header['topic']}, got {header['type']}")
        return b""

    def _make_callback(self, topic: str, handle: Callable[[Any], None]) -> Callable[[Any], None]:
        """Call back, and warn of bytes that are not a valid message."""

        def on_message(message: Any) -> None:  # noqa: ANN401
            try:
                handle(message)
            except MessageError as error:
                self.core.refuse_message("message", f"{topic}: {error}")

        return on_message

    def _advertise_services(self) -> None:
        rospy, services = self._ros["rospy"], self._ros["std_srvs.srv"]
        get_map = self._ros["nav_msgs.srv"].GetMap
        answer_class = response_class(get_map._response_class)

        def dynamic_map(request: Any) -> Any:  # noqa: ANN401
            latest = self.core.dynamic_map()
            if latest is None:
                raise rospy.ServiceException("there is no map yet")
            return answer_class(map=self._grid(latest))

        def reset(request: Any) -> Any:  # noqa: ANN401
            self.core.reset()
            return services.EmptyResponse()

        def pause(request: Any) -> Any:  # noqa: ANN401
            self.core.pause(request.data)
            return services.SetBoolResponse(True, "paused" if request.data else "mapping")

        def save(request: Any) -> Any:  # noqa: ANN401
            return services.TriggerResponse(*save_results(self.core, self._out))

        rospy.Service("dynamic_map", get_map, dynamic_map)
        rospy.Service("~reset", services.Empty, reset)
        if self.core.localizes:
            rospy.Service("global_localization", services.Empty, reset)
        rospy.Service("~pause", services.SetBool, pause)
        rospy.Service("~save", services.Trigger, save)

    def _grid(self, message: GridMessage) -> Any:  # noqa: ANN401
        grid = self._grid_class()
        height, width = message.cells.shape
        grid.header.stamp, grid.header.frame_id = self._stamp(message.stamp_ns), message.frame
        grid.info.map_load_time = grid.header.stamp
        grid.info.resolution, grid.info.width, grid.info.height = message.resolution_m, width, height
        grid.info.origin.position.x, grid.info.origin.position.y = message.origin
        grid.info.origin.orientation.w = 1.0
        grid.cells = message.cells.tobytes()
        return grid

    def _stamp(self, stamp_ns: int) -> Any:  # noqa: ANN401
        return self._ros["rospy"].Time(*divmod(stamp_ns, 1_000_000_000))

    def _publish(self, publisher: Any, message: Any) -> None:  # noqa: ANN401
        rospy = self._ros["rospy"]
        try:
            if not rospy.is_shutdown():
                publisher.publish(message)
        except rospy.ROSException:  # shut down in the meantime
            return


def _wait_for_master(on_poll: Callable[[], None]) -> None:
    """Wait for roscore, as slam_gmapping does."""
    graph = importlib.import_module("rosgraph")
    if not graph.is_master_online():
        print(f"gridslam: waiting for a master at {graph.get_master_uri()}", file=sys.stderr, flush=True)
    while not graph.is_master_online():
        time.sleep(_POLL_S)
        on_poll()


def run_ros1(
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
        ROS arguments: ``scan:=base_scan``, ``_particles:=80``, ``__name:=mapper``.
    given : mapping, optional
        Parameters of the node that override its private parameters.
    open_viewers : callable
        Called with the core before it starts: see `gridslam.ros.node.services.ViewerOpener`.
    on_poll : callable
        Called several times a second; may raise KeyboardInterrupt.

    Raises
    ------
    ConfigurationError
        ROS 1 is not available, or an argument or parameter is invalid.
    GridslamError
        The node cannot be started, or its filter failed.
    """
    rospy = _modules()["rospy"]
    check_ros1_arguments(arguments)
    _wait_for_master(on_poll)
    try:
        rospy.init_node(NODE_NAME, argv=["gridslam", *arguments], disable_signals=True)
    except rospy.ROSInitException as error:
        raise GridslamError(f"the node cannot be started: {error}") from None
    private = rospy.get_param("~", {})
    parameters = node_parameters({**private, **(given or {})})
    check_folder(parameters.out)
    node = Ros1Node(parameters)
    with open_viewers(node.core):
        try:
            node.start()
            while not rospy.is_shutdown() and not node.core.ended.wait(_POLL_S):
                on_poll()
        except KeyboardInterrupt:  # the usual end of a node
            pass
        finally:
            close_node(node.core, parameters.out, node.log)
            rospy.signal_shutdown("done")
    if node.core.failure is not None:
        raise GridslamError(f"the filter failed: {node.core.failure}") from node.core.failure
