"""Conversion of maps to messages, of the best particle's in a thread of its own."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.io.maps import FREE_THRESH, OCCUPIED_THRESH
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.ros.node.messages import GridMessage
from gridslam.ros.node.parameters import NodeSettings
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import OccupancyGrid

_PATIENCE_S = 10.0  # with a subscriber of the map that is slow


def map_cells(grid: OccupancyGrid) -> NDArray[np.int8]:
    """Return the cells (H, W) of nav_msgs/OccupancyGrid, as `write_map`: 100 above probability 0.65, 0 below 0.196."""
    cells = np.full(grid.known.shape, -1, np.int8)
    cells[grid.known & (grid.log_odds > math.log(OCCUPIED_THRESH / (1 - OCCUPIED_THRESH)))] = 100
    cells[grid.known & (grid.log_odds < math.log(FREE_THRESH / (1 - FREE_THRESH)))] = 0
    return cells


def make_grid_message(grid: OccupancyGrid, settings: NodeSettings, stamp_ns: int) -> GridMessage:
    """Return the message of a map."""
    x, y = (float(value) for value in grid.origin)
    return GridMessage(stamp_ns, settings.map_frame, grid.resolution_m, (x, y), map_cells(grid))


@final
class MapRenderer:
    """Renders maps in a thread of its own.

    The filter's thread copies only the tiles of the map, so its cost depends on the mapped area, not on the rectangle.

    Parameters
    ----------
    mapper : OccupancyGridMapping
        Mapper of the filter.
    settings : NodeSettings
        Frame and values of the map.
    publish : callable
        Publishes each map; called in the renderer's thread.

    Attributes
    ----------
    latest : GridMessage or None
        The last rendered map.
    mapper : OccupancyGridMapping
        As given.
    """

    def __init__(
        self,
        mapper: OccupancyGridMapping,
        settings: NodeSettings,
        publish: Callable[[GridMessage], None],
    ) -> None:
        self.latest: GridMessage | None = None
        self.mapper = mapper
        self._settings = settings
        self._publish = publish
        self._executor = ThreadPoolExecutor(1, "gridslam-map")
        self._rendered: Future[None] | None = None

    @property
    def is_idle(self) -> bool:
        """Whether the last map is rendered."""
        return self._rendered is None or self._rendered.done()

    def render(self, state: GridFastSlamState, stamp_ns: int) -> int:
        """Copy the best particle's map for rendering; returns the memory of all maps, bytes.

        Call when idle; raises what rendering the map before raised.
        """
        before = self._rendered
        self._rendered = None  # one that failed is reported once
        if before is not None:
            before.result()
        arrays = state.maps.snapshot(np.array([state.best])).to_arrays()
        self._rendered = self._executor.submit(self._render, arrays, stamp_ns)
        return state.maps.nbytes

    def reset(self) -> None:
        """Discard the map at the start of a new session."""
        self.finish()
        self.latest = None

    def close(self) -> None:
        """Render the pending map and stop the thread."""
        self.finish()
        self._executor.shutdown(wait=False)

    def finish(self) -> None:
        """Wait until the pending map is published, as before another map takes its place."""
        if self._rendered is not None:
            wait([self._rendered], _PATIENCE_S)

    def _render(self, arrays: Mapping[str, NDArray[Any]], stamp_ns: int) -> None:
        grid = self.mapper.restore(arrays).occupancy(0)
        self.latest = make_grid_message(grid, self._settings, stamp_ns)
        self._publish(self.latest)
