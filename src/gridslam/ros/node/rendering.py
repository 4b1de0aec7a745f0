"""Conversion of the best particle's map to a message, in a thread of its own."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

from gridslam.io.maps import FREE_THRESH, OCCUPIED_THRESH
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.ros.node.messages import GridMessage
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import OccupancyGrid

__all__ = ["MapRenderer", "map_cells"]

MapArrays = Mapping[str, NDArray[Any]]


def map_cells(grid: OccupancyGrid, values: Literal["trinary", "probability"]) -> NDArray[np.int8]:
    """Return the cells (H, W) of nav_msgs/OccupancyGrid.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    values : str
        "trinary": 100 above probability 0.65, 0 below 0.196 and -1 between, as in `write_map`;
        "probability": in per cent, -1 where unknown.
    """
    cells = np.full(grid.known.shape, -1, np.int8)
    if values == "trinary":
        cells[grid.known & (grid.log_odds > math.log(OCCUPIED_THRESH / (1 - OCCUPIED_THRESH)))] = 100
        cells[grid.known & (grid.log_odds < math.log(FREE_THRESH / (1 - FREE_THRESH)))] = 0
    else:
        cells[grid.known] = np.rint(100 * grid.probability[grid.known])
    return cells


@final
class MapRenderer:
    """Renders maps in a thread of its own.

    The filter's thread copies only the tiles of the map, so its cost depends on the mapped area, not on the rectangle.

    Parameters
    ----------
    mapper : OccupancyGridMapping
        Mapper of the filter.
    values : str
        As for `map_cells`.
    frame : str
        Frame of the map.
    publish : callable
        Publishes each map; called in the renderer's thread.

    Attributes
    ----------
    latest : GridMessage or None
        The last rendered map.
    """

    def __init__(
        self,
        mapper: OccupancyGridMapping,
        values: Literal["trinary", "probability"],
        frame: str,
        publish: Callable[[GridMessage], None],
    ) -> None:
        self.latest: GridMessage | None = None
        self._mapper, self._values, self._frame, self._publish = mapper, values, frame, publish
        self._changed = threading.Condition()
        self._pending: tuple[int, MapArrays] | None = None
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run, name="gridslam-map", daemon=True)

    def start(self, stamp_ns: int) -> None:
        """Start the thread; there is no map yet."""
        self._thread.start()

    @property
    def is_idle(self) -> bool:
        """Whether the last map is rendered."""
        return not self._busy

    def render(self, state: GridFastSlamState, stamp_ns: int) -> int:
        """Copy the best particle's map for rendering; returns the memory of all maps, bytes."""
        arrays = state.maps.snapshot(np.array([state.best])).to_arrays()
        with self._changed:
            self._pending, self._busy = (stamp_ns, arrays), True
            self._changed.notify_all()
        return state.maps.nbytes

    def reset(self) -> None:
        """Discard the map at the start of a new session."""
        with self._changed:
            self._changed.wait_for(lambda: not self._busy, timeout=10)
            self.latest = None

    def close(self) -> None:
        """Render the pending map and stop the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        if self._thread.ident is not None:
            self._thread.join(timeout=10)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._pending is not None or self._closed)
                if self._pending is None:
                    return
                (stamp_ns, arrays), self._pending = self._pending, None
            grid = self._mapper.restore(arrays).occupancy(0)
            x, y = (float(value) for value in grid.origin)
            self.latest = GridMessage(stamp_ns, self._frame, grid.resolution_m, (x, y), map_cells(grid, self._values))
            self._publish(self.latest)
            with self._changed:
                self._busy = self._pending is not None
                self._changed.notify_all()
