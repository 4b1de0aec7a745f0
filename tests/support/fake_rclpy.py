"""A stand-in for rclpy with the part of its interface that the node uses, and with its traps. It is no ROS 2.

The interface is that of Humble to Jazzy, as their documentation has it.
"""

from __future__ import annotations

import sys
import time
import types
from collections.abc import Callable
from enum import Enum
from queue import Queue
from types import SimpleNamespace
from typing import Any

from gridslam.ros.node.service_types import service_encoder

TYPES = {
    "sensor_msgs.msg": ["LaserScan"],
    "tf2_msgs.msg": ["TFMessage"],
    "nav_msgs.msg": ["OccupancyGrid", "MapMetaData"],
    "geometry_msgs.msg": ["PoseWithCovarianceStamped", "PoseArray"],
    "std_msgs.msg": ["Float64"],
    "map_msgs.msg": ["OccupancyGridUpdate"],
    "nav_msgs.srv": ["GetMap", "SetMap"],
    "diagnostic_msgs.msg": ["DiagnosticArray"],
    "std_srvs.srv": ["Empty", "SetBool", "Trigger"],
    "rcl_interfaces.msg": ["ParameterEvent"],
    "rcl_interfaces.srv": [
        *("ListParameters", "GetParameters", "GetParameterTypes"),
        *("DescribeParameters", "SetParameters", "SetParametersAtomically"),
    ],
    "lifecycle_msgs.msg": ["TransitionEvent"],
    "lifecycle_msgs.srv": ["GetState", "GetAvailableStates", "GetAvailableTransitions", "ChangeState"],
}


class World:
    """What went through the stand-in, and what tests put into it."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        self.parameters = {"use_sim_time": False, **parameters}
        self.others: dict[str, list[str]] = {}
        self.published: dict[str, list[bytes]] = {}
        self.publishers: dict[str, tuple[str, Any]] = {}
        self.subscriptions: dict[str, tuple[str, Any, Callable[[bytes], None]]] = {}
        self.services: dict[str, Callable[[Any, Any], Any]] = {}
        self.logged: list[tuple[str, str]] = []
        self.severities: dict[Any, str] = {}
        self.nodes: list[Any] = []
        self.clock_ns = 0
        self.signals = ""
        self.running = True
        self.spun: Callable[[], None] = lambda: None


class RCLError(RuntimeError):
    """What publishing raises once the context is shut down."""


class Logger:
    """Keeps what is said; as in rclpy, a place in the code cannot change its severity."""

    def __init__(self, said: list[tuple[str, str]], severities: dict[Any, str]) -> None:
        self.said, self.severities = said, severities

    def info(self, text: str) -> None:
        self.log("info", text)

    def warning(self, text: str) -> None:
        self.log("warning", text)

    def error(self, text: str) -> None:
        self.log("error", text)

    def log(self, severity: str, text: str) -> None:
        caller = sys._getframe(2)
        if self.severities.setdefault((caller.f_code, caller.f_lasti), severity) != severity:
            raise ValueError("Logger severity cannot be changed between calls.")
        self.said.append((severity, text))


class Node:
    world: World

    def __init__(self, name: str, **options: bool) -> None:
        assert options == {
            "allow_undeclared_parameters": True,
            "automatically_declare_parameters_from_overrides": True,
            "start_parameter_services": False,
        }
        self.name, self.destroyed = name, False
        self.world.nodes.append(self)

    def get_name(self) -> str:
        return self.name

    def get_fully_qualified_name(self) -> str:
        return f"/{self.name}"

    def has_parameter(self, name: str) -> bool:
        return name in self.world.parameters

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.world.parameters[name])

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Any]:
        assert prefix == ""
        return {name: SimpleNamespace(value=value) for name, value in self.world.parameters.items()}

    def resolve_topic_name(self, name: str) -> str:
        return f"/{name}"

    def create_publisher(self, kind: type, topic: str, profile: Any, *, qos_overriding_options: Any) -> Any:
        assert len(qos_overriding_options) == 4
        self.world.publishers[topic] = kind.__name__, profile

        def publish(data: bytes) -> None:
            if not self.world.running:
                raise RCLError("Failed to publish: publisher's context is invalid")
            self.world.published.setdefault(topic, []).append(data)

        return SimpleNamespace(publish=publish)

    def create_subscription(
        self,
        kind: type,
        topic: str,
        callback: Callable[[bytes], None],
        profile: Any,
        *,
        raw: bool,
        qos_overriding_options: Any,
    ) -> None:
        assert raw
        self.world.subscriptions[topic] = kind.__name__, profile, callback

    def create_service(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> Any:
        answers: Queue[Any] = Queue()
        offered = SimpleNamespace(send_response=lambda response, header: answers.put(response))

        def call(request: Any) -> Any:
            """Do what an executor does, and wait for what is sent."""
            offered.send_response(callback(request, SimpleNamespace()), "header")
            return answers.get(timeout=60)

        self.world.services[name] = call
        return offered

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        return [SimpleNamespace(topic_type=kind) for kind in self.world.others.get(topic, ())]

    def set_parameters(self, parameters: list[Any]) -> None:
        self.world.parameters.update({one.name: one.value for one in parameters})

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=self.world.clock_ns))

    def get_logger(self) -> Any:
        return Logger(self.world.logged, self.world.severities)

    def destroy_node(self) -> None:
        self.destroyed = True


SLAM_TOOLBOX = ["SerializePoseGraph", "DeserializePoseGraph", "SaveMap", "Pause", "Clear", "Reset"]


def installed(monkeypatch: Any, parameters: dict[str, Any], slam_toolbox: bool = False) -> World:
    """Put the stand-in where `import rclpy` finds it, with slam_toolbox's types if they are wanted."""
    world = World(parameters)
    Node.world = world

    class ExternalShutdownException(Exception):  # noqa: N818 - rclpy's name
        pass

    class SingleThreadedExecutor:
        def add_node(self, node: Node) -> None:
            assert node in world.nodes

        def spin_once(self, timeout_sec: float) -> None:
            world.spun()
            time.sleep(0.01)

        def shutdown(self) -> None:
            pass

    encoder = service_encoder()

    def deserialize_message(data: bytes, kind: type) -> Any:
        return encoder.decode(f"{kind.service}_ResponseBody", data)

    def module(name: str, **contents: Any) -> None:
        made = types.ModuleType(name)
        made.__dict__.update(contents)
        monkeypatch.setitem(sys.modules, name, made)

    def init(*, args: list[str], signal_handler_options: Any) -> None:
        world.signals = signal_handler_options.name

    module("rclpy", init=init, ok=lambda: world.running, try_shutdown=lambda: None)
    module("rclpy.utilities", remove_ros_args=lambda args: args[: [*args, "--ros-args"].index("--ros-args")])
    module("rclpy.node", Node=Node)
    module("rclpy.signals", SignalHandlerOptions=Enum("SignalHandlerOptions", "NO SIGINT SIGTERM ALL"))
    module("rclpy.serialization", deserialize_message=deserialize_message)
    module(
        "rclpy.executors",
        SingleThreadedExecutor=SingleThreadedExecutor,
        ExternalShutdownException=ExternalShutdownException,
    )
    module("rclpy.qos_overriding_options", QoSOverridingOptions=tuple)
    module("rclpy.parameter", Parameter=lambda name, value: SimpleNamespace(name=name, value=value))
    module(
        "rclpy.qos",
        QoSProfile=lambda **policies: SimpleNamespace(**policies),
        QoSPolicyKind=Enum("QoSPolicyKind", "HISTORY DEPTH RELIABILITY DURABILITY"),
        HistoryPolicy=Enum("HistoryPolicy", "KEEP_LAST"),
        ReliabilityPolicy=Enum("ReliabilityPolicy", "RELIABLE BEST_EFFORT"),
        DurabilityPolicy=Enum("DurabilityPolicy", "VOLATILE TRANSIENT_LOCAL"),
    )
    more = {"slam_toolbox.srv": SLAM_TOOLBOX} if slam_toolbox else {}
    for name, kinds in {**TYPES, **more}.items():
        module(name.partition(".")[0])
        package = name.partition(".")[0]
        made = {
            kind: type(kind, (), {"Response": type("Response", (), {"service": f"{package}/{kind}"})}) for kind in kinds
        }
        module(name, **made)
    return world
