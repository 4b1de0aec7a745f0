"""What a transport of the node is: the topics that it publishes, and the Protocol behind which each stands."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import Any, Final, Protocol, TypeAlias, final

from gridslam.errors import ConfigurationError
from gridslam.io.bags.encoder import MessageEncoder
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.messages import Outputs

TOPICS: Final = {
    "map": "nav_msgs/OccupancyGrid",
    "map_metadata": "nav_msgs/MapMetaData",
    "/tf": "tf2_msgs/TFMessage",
    "~/pose": "geometry_msgs/PoseWithCovarianceStamped",
    "~/entropy": "std_msgs/Float64",
    "particlecloud": "geometry_msgs/PoseArray",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
}
"""Published topics and their types; ~ is the node's own name."""

ALL_TOPICS: Final = {
    **TOPICS,
    "amcl_pose": "geometry_msgs/PoseWithCovarianceStamped",
    "particle_cloud": "nav2_msgs/ParticleCloud",
}
"""Published by a node that localizes: also the pose and the particles, with the names and types of nav2."""

LATCHED: Final = ("map", "map_metadata", "~/entropy", "amcl_pose")
"""Topics whose last message late subscribers receive."""

POLL_S: Final = 0.2
"""Time between two looks at what may end a node, s."""

Handler: TypeAlias = Callable[[bytes], None]
"""Called with the bytes of a message."""

Serve: TypeAlias = Callable[[Any], Sequence[Any] | bytes | None]
"""Called with a request; returns the values of the response's fields in their order, or the bytes of all of them."""

ViewerOpener: TypeAlias = Callable[[NodeCore], AbstractContextManager[object]]
"""Opens the viewers of a core: a context entered before the core starts and left after it has stopped."""


@final
@dataclass(frozen=True, slots=True)
class RunOptions:
    """What those who run a node give beside ROS's arguments.

    Attributes
    ----------
    given : mapping
        Parameters that override those of ROS.
    open_viewers : callable
        Called with the core before it starts: see `ViewerOpener`.
    on_poll : callable
        Called several times a second; may raise KeyboardInterrupt.
    """

    given: Mapping[str, Any] = field(default_factory=dict)
    open_viewers: ViewerOpener = nullcontext
    on_poll: Callable[[], None] = lambda: None


NO_OPTIONS: Final = RunOptions()


def import_ros(ros: str, hint: str, name: str, folder: str = "msg") -> Any:  # noqa: ANN401
    """Import a module of "ROS 1" or "ROS 2", or a type such as "nav_msgs/GetMap" from a folder of its package.

    Raises ConfigurationError with a hint if it is not installed.
    """
    package, _, kind = name.partition("/")
    try:
        module = importlib.import_module(f"{package}.{folder}" if kind else name)
        return getattr(module, kind) if kind else module
    except (ImportError, AttributeError) as error:
        raise ConfigurationError(f"{name} of {ros} is not available ({error}): {hint}") from None


class Transport(Protocol):
    """What carries the node's messages.

    Attributes
    ----------
    outputs : Outputs
        Publishes what the node reports.
    encoder : MessageEncoder
        Of its messages, requests and responses.
    global_localization : str
        Name of the service that makes the pose unknown.
    """

    outputs: Outputs
    encoder: MessageEncoder
    global_localization: str

    def connect(self, refuse: Callable[[str, str], None], topics: Mapping[str, str]) -> None:
        """Announce the published topics with their types, and set `outputs.topics`.

        `refuse` is called with kind and problem of what cannot be received.
        """

    def resolve(self, topic: str) -> str:
        """Return the full name of a topic or service, after remapping."""
        ...

    def subscribe(
        self, topic: str, kind: str, handle: Handler, *, reliable: bool = True, latched: bool = False, depth: int = 10
    ) -> None:
        """Subscribe to the messages of a type; `latched`: also to the last one of a publisher that was there before."""

    def advertise(self, service: str, kind: str, serve: Serve, *, slow: bool = False) -> None:
        """Offer a service, of which a slow one must not delay scans."""

    def spin(self, ended: threading.Event) -> Iterator[None]:
        """Deliver messages until the transport is shut down or the event is set; yields several times a second."""
        ...

    def close(self) -> None:
        """Shut down."""
