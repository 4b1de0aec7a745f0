"""The live node: one core, and the transports that carry its messages."""

from gridslam.ros.core import NodeCore
from gridslam.ros.settings import NodeSettings

__all__ = ["NodeCore", "NodeSettings"]
