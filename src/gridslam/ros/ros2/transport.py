"""What both ways into ROS 2 share: parameters are services and a topic, which either offers."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from gridslam.io.bags.encoder import Values
from gridslam.io.bags.ros_messages import Wire, wire_of_cdr
from gridslam.ros.node.messages import Level, Outputs
from gridslam.ros.node.outputs import EncodedOutputs
from gridslam.ros.node.parameters import NodeParameters
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.node.service_types import service_encoder
from gridslam.ros.node.transport import LATCHED, RunOptions, Transport
from gridslam.ros.ros2.arguments import find_foreign_files
from gridslam.ros.ros2.parameter_services import ParameterServices

_PARAMETER_EVENTS: Final = "/parameter_events"
_PARAMETER_EVENT: Final = "rcl_interfaces/ParameterEvent"
_SIM_TIME: Final = "use_sim_time"


class Ros2Transport(Transport):
    """A transport of ROS 2.

    Parameters
    ----------
    name : str
        Full name of the node.
    simulated : bool
        Whether to use the time of /clock.
    """

    global_localization = "reinitialize_global_localization"
    gives_empty_map = True

    def __init__(self, name: str, *, simulated: bool) -> None:
        self.encoder = service_encoder()
        self.outputs: Outputs = EncodedOutputs(
            self.encoder, self._publish, self._now_ns, self._log, name.rpartition("/")[2]
        )
        self._name = name
        self._simulated = simulated
        self._refuse: Callable[[str, str], None] = lambda kind, problem: None

    def connect(self, refuse: Callable[[str, str], None], topics: Mapping[str, str]) -> None:
        """Create the publishers; `refuse` is called with kind and problem of what cannot be received."""
        self._refuse = refuse
        self.outputs.topics = tuple(
            topic
            for topic, kind in topics.items()
            if self._add_publisher(topic, kind, latched=topic in LATCHED, depth=1 if topic in LATCHED else 10)
        )
        self._add_publisher(_PARAMETER_EVENTS, _PARAMETER_EVENT, latched=False, depth=1000)

    def wire_of(self, data: bytes) -> Wire:
        """Return the encoding of a message; raises MessageError if it has none."""
        return wire_of_cdr(data)

    def advertise_parameters(
        self, values: Mapping[str, Any], change: Callable[[str, Any], str], settable: Sequence[str]
    ) -> None:
        """Offer the parameters to `ros2 param`."""

        def change_any(name: str, value: Any) -> str:  # noqa: ANN401
            if name != _SIM_TIME:
                return change(name, value)
            self._use_sim_time(value)
            return ""

        def report(new: Sequence[Values], changed: Sequence[Values]) -> None:
            stamp = divmod(self._now_ns(), 1_000_000_000)
            data = self.encoder.encode(_PARAMETER_EVENT, stamp, self._name, new, changed, [])
            self._publish(_PARAMETER_EVENTS, data)

        values = {**values, _SIM_TIME: self._simulated}
        services = ParameterServices(values, change_any, (*settable, _SIM_TIME), report)
        for name, (kind, serve) in services.services().items():
            self.advertise(f"~/{name}", kind, serve)

    def _refuse_request(self, service: str, problem: str) -> None:
        """Report why a request is not answered."""
        self._refuse("request", f"{self.resolve(service)}: {problem}")

    def run(self, arguments: Sequence[str], parameters: NodeParameters, options: RunOptions) -> None:
        """Run the node until it is stopped."""
        for sentence in find_foreign_files(arguments, self._name):
            self.outputs.log(Level.WARN, sentence)
        RosNode(self, parameters).run(options)

    @abstractmethod
    def _add_publisher(self, topic: str, kind: str, *, latched: bool, depth: int) -> bool:
        """Create a publisher; return whether it can be one."""

    @abstractmethod
    def _use_sim_time(self, simulated: bool) -> None:
        """Take the time from /clock, or from the system."""

    @abstractmethod
    def _publish(self, topic: str, data: bytes) -> None:
        """Publish bytes on a topic that has a publisher."""

    @abstractmethod
    def _now_ns(self) -> int:
        """Return the node's time."""

    @abstractmethod
    def _log(self, level: Level, text: str) -> None:
        """Log to the console and /rosout."""
