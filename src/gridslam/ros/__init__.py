"""The live node: a transport-independent core, and the transports for ROS 1 and ROS 2."""

from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.parameters import NodeSettings

__all__ = ["NodeCore", "NodeSettings"]
