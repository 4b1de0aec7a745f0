"""Which frame lies where, and when: the tree of links that a robot publishes."""

from gridslam.transforms.buffer import TransformBuffer
from gridslam.transforms.link import LinkStatistics
from gridslam.transforms.missing import Coverage, MissingTransform

__all__ = ["Coverage", "LinkStatistics", "MissingTransform", "TransformBuffer"]
