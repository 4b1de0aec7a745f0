"""Messages of ROS 2 as bytes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gridslam.io.bags.encoder import MessageEncoder

ENCODER = MessageEncoder(is_ros1=False)


def encode_message(message_type: str, values: Sequence[Any]) -> bytes:
    """Bytes of a message; nested messages are sequences, too."""
    return ENCODER.encode(message_type, *values)
