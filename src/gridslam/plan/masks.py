"""Masks of nav2's costmap filters: where robots may not go, and how fast they may."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gridslam.io.edited_maps import cells_of
from gridslam.io.edits import Edits
from gridslam.io.maps import MapDescription
from gridslam.types import OccupancyGrid


@final
class Mask(NamedTuple):
    """Values of a filter's mask, as an OccupancyGrid of ROS has them, and their meaning.

    Attributes
    ----------
    values : (H, W) int8, 0 to 100
        The first row is the lowest one.
    kind : int
        nav2's: 0 cost in percent of a lethal one, 1 speed in percent of the highest; 0 sets no limit.
    """

    values: NDArray[np.int8]
    kind: int


def make_keepout_mask(grid: OccupancyGrid, edits: Edits) -> Mask:
    """Draw keep-out polygons and no-go lines with 100 in the cells of the map."""
    values = np.zeros(grid.shape, np.int8)
    for edit in edits.of("keep_out", "no_go"):
        window, inside = cells_of(edit, grid)
        values[window][inside] = 100
    return Mask(values, 0)


def make_speed_mask(grid: OccupancyGrid, edits: Edits) -> Mask:
    """Draw speed zones, in percent of the highest speed; where they overlap the lowest limit holds."""
    values = np.zeros(grid.shape, np.int8)
    for edit in sorted(edits.of("speed"), key=lambda edit: -edit.limit_percent):
        window, inside = cells_of(edit, grid)
        values[window][inside] = max(1, int(edit.limit_percent))
    return Mask(values, 1)


def write_mask(yaml_path: Path, mask: Mask, grid: OccupancyGrid) -> None:
    """Write a mask as a YAML file and a PGM beside it, white 0 and black 100: map_server reads exactly its values."""
    image = yaml_path.with_suffix(".pgm")
    Image.fromarray(np.rint(255 * (1 - mask.values[::-1] / 100)).astype(np.uint8)).save(image)
    x, y = (float(value) for value in grid.origin)
    text = MapDescription(image.name, float(grid.resolution_m), (x, y), False, 1.0, 0.0, "scale").to_yaml()
    yaml_path.write_text(text, encoding="utf-8")
