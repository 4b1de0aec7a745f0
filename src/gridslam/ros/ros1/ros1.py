"""The node in ROS 1 by rospy: a drop-in replacement for slam_gmapping.

Messages pass through rospy as bytes, which is fast for large scans and maps and works with any version of NumPy.

Source: the interface of slam_gmapping, http://wiki.ros.org/gmapping.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, final

from gridslam.errors import ConfigurationError, GridslamError
from gridslam.io.bags.encoder import MessageEncoder
from gridslam.io.bags.ros_messages import kind_of
from gridslam.ros.node.messages import Level, Outputs
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.parameters import GMAPPING_DEFAULTS, NODE_DEFAULTS, node_parameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.node.transport import LATCHED, NO_OPTIONS, POLL_S, Handler, RunOptions, Serve, import_ros

NODE_NAME = "slam_gmapping"

_import = partial(import_ros, "ROS 1", "source its setup.bash, or install python3-rospy and the messages' packages")


def _name(topic: str) -> str:
    """Return a name as ROS 1 has it: ~pose, and not ~/pose."""
    return topic.replace("~/", "~")


@final
class Ros1Transport:
    """Publishers, subscribers and services of the node, after `rospy.init_node`."""

    global_localization = "global_localization"

    def __init__(self) -> None:
        self._rospy = _import("rospy")
        self.encoder = MessageEncoder(is_ros1=True)
        self._publishers: dict[str, Any] = {}
        name = self._rospy.get_name().lstrip("/")
        self.outputs: Outputs = EncodedOutputs(self.encoder, self._publish, self._now_ns, self._log, name)

    def connect(self, refuse: Callable[[str, str], None], topics: Mapping[str, str]) -> None:
        """Create the publishers; `refuse` is called with kind and problem of what cannot be received."""
        self._refuse = refuse
        topics = {topic: kind for topic, kind in topics.items() if not kind.startswith("nav2_msgs/")}
        self.outputs.topics = tuple(topics)
        for topic, kind in topics.items():
            options = {"queue_size": 1, "latch": True} if topic in LATCHED else {"queue_size": 10}
            self._publishers[topic] = self._rospy.Publisher(_name(topic), _import(kind), **options)

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic, after remapping."""
        return str(self._rospy.resolve_name(_name(topic)))

    def subscribe(
        self, topic: str, kind: str, handle: Handler, *, reliable: bool = True, latched: bool = False, depth: int = 10
    ) -> None:
        """Subscribe to the bytes of messages, which TCP carries reliably; none is dropped before it is handled."""

        def on_message(message: Any) -> None:  # noqa: ANN401
            header = message._connection_header
            if header["type"] == kind or (kind_of(kind) and kind_of(header["type"]) == kind_of(kind)):
                handle(message._buff)
            else:
                self._refuse("message", f"expected {kind} on {header['topic']}, got {header['type']}")

        options = {"queue_size": None, "buff_size": 1 << 24, "tcp_nodelay": True}
        self._rospy.Subscriber(_name(topic), self._rospy.AnyMsg, on_message, **options)

    def advertise(self, service: str, kind: str, serve: Serve, *, slow: bool = False) -> None:
        """Offer a service; rospy answers each request in a thread of its own."""
        service_class = _import(kind, "srv")
        make: Any = service_class._response_class

        def answer(request: Any) -> Any:  # noqa: ANN401
            try:
                answered = serve(request)
            except GridslamError as error:
                raise self._rospy.ServiceException(str(error)) from None
            return make().deserialize(answered) if isinstance(answered, bytes) else make(*answered or ())

        self._rospy.Service(_name(service), service_class, answer)

    def spin(self, ended: threading.Event) -> Iterator[None]:
        """Wait until ROS is shut down or the event is set; rospy delivers messages in threads of its own."""
        while not self._rospy.is_shutdown() and not ended.wait(POLL_S):
            yield

    def close(self) -> None:
        """Shut down."""
        self._rospy.signal_shutdown("done")

    def _now_ns(self) -> int:
        return int(self._rospy.Time.now().to_nsec())

    def _log(self, level: Level, text: str) -> None:
        """Log to the console and /rosout."""
        rospy = self._rospy
        {Level.OK: rospy.loginfo, Level.WARN: rospy.logwarn, Level.ERROR: rospy.logerr}[level]("%s", text)
        sys.stdout.flush()  # rospy does not flush

    def _publish(self, topic: str, data: bytes) -> None:
        message = self._rospy.AnyMsg()
        message._buff = data
        try:
            if not self._rospy.is_shutdown() and topic in self._publishers:
                self._publishers[topic].publish(message)
        except self._rospy.ROSException:  # shut down in the meantime
            return


def check_ros1_arguments(arguments: Sequence[str]) -> None:
    """Raise ConfigurationError for an argument that rospy would ignore.

    That is one other than ``name:=value``, and a parameter without its underscore.
    """
    for argument in arguments:
        name, sign, _ = argument.partition(":=")
        if not sign or not name or name.startswith("-"):
            raise ConfigurationError(f"expected an option, _PARAMETER:=VALUE or TOPIC:=OTHER, got {argument!r}")
        if name in GMAPPING_DEFAULTS or name in NODE_DEFAULTS:
            raise ConfigurationError(f"{argument}: this would remap a topic; a parameter is given as _{argument}")


def _wait_for_master(on_poll: Callable[[], None]) -> None:
    """Wait for roscore, as slam_gmapping does."""
    graph = _import("rosgraph")
    if not graph.is_master_online():
        print(f"gridslam: waiting for a master at {graph.get_master_uri()}", file=sys.stderr, flush=True)
    while not graph.is_master_online():
        time.sleep(POLL_S)
        on_poll()


def run_ros1(arguments: Sequence[str] = (), options: RunOptions = NO_OPTIONS) -> None:
    """Run the node until ROS or Ctrl-C shuts it down, then write the results to `out`.

    Parameters
    ----------
    arguments : sequence of str
        ROS arguments: ``scan:=base_scan``, ``_particles:=80``, ``__name:=mapper``.
    options : RunOptions
        Parameters and viewers.

    Raises
    ------
    ConfigurationError
        ROS 1 is not available, or an argument or parameter is invalid.
    GridslamError
        The node cannot be started, or its filter failed.
    """
    rospy = _import("rospy")
    check_ros1_arguments(arguments)
    _wait_for_master(options.on_poll)
    try:
        rospy.init_node(NODE_NAME, argv=["gridslam", *arguments], disable_signals=True)
    except rospy.ROSInitException as error:
        raise GridslamError(f"the node cannot be started: {error}") from None
    parameters = node_parameters({**rospy.get_param("~", {}), **options.given})
    RosNode(Ros1Transport(), parameters).run(options)
