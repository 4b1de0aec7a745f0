"""Which frame lies where, and when: the tree of links that a robot publishes."""

from gridslam.transforms.buffer import MissingTransform, TransformBuffer
from gridslam.transforms.link import Coverage

__all__ = ["Coverage", "MissingTransform", "TransformBuffer"]
