"""ROS 1 messages that serialize large arrays directly from memory."""

from __future__ import annotations

import io
import struct
from typing import Any

__all__ = ["cloud_class", "grid_class", "response_class"]


def grid_class(base: Any) -> Any:  # noqa: ANN401
    """Return an OccupancyGrid class that sends the bytes `cells`; a list of a million cells would cost 50 ms."""

    class Grid(base):  # type: ignore[misc]
        cells = b""

        def serialize(self, buff: io.BytesIO) -> None:
            head = io.BytesIO()
            super().serialize(head)  # with no data: its last four bytes are the length 0
            buff.write(head.getvalue()[:-4])
            buff.write(struct.pack("<I", len(self.cells)))
            buff.write(self.cells)

    return Grid


def cloud_class(base: Any) -> Any:  # noqa: ANN401
    """Return a PoseArray class that sends the bytes `data`."""

    class Cloud(base):  # type: ignore[misc]
        count, data = 0, b""

        def serialize(self, buff: io.BytesIO) -> None:
            head = io.BytesIO()
            super().serialize(head)
            buff.write(head.getvalue()[:-4])
            buff.write(struct.pack("<I", self.count))
            buff.write(self.data)

    return Cloud


def response_class(base: Any) -> Any:  # noqa: ANN401
    """Return a response class of nav_msgs/GetMap for such a grid."""

    class Response(base):  # type: ignore[misc]
        def serialize(self, buff: io.BytesIO) -> None:
            self.map.serialize(buff)

    return Response
