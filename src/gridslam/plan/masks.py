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


def describe_filters(masks: dict[str, Mask]) -> str:
    """Parameters of nav2 (YAML) for masks by name: "keepout" and "speed"; their servers, and the costmap's filters."""
    servers, filters, names = "", "", []
    for name, mask in masks.items():
        plugin = {"keepout": "nav2_costmap_2d::KeepoutFilter", "speed": "nav2_costmap_2d::SpeedFilter"}[name]
        speed_topic = '        speed_limit_topic: "speed_limit"\n' if name == "speed" else ""
        names += [f"{name}_filter_mask_server", f"{name}_costmap_filter_info_server"]
        servers += f"""\
{name}_filter_mask_server:
  ros__parameters:
    topic_name: "{name}_filter_mask"
    frame_id: "map"
    yaml_filename: "{name}_mask.yaml"
{name}_costmap_filter_info_server:
  ros__parameters:
    type: {mask.kind}
    filter_info_topic: "{name}_costmap_filter_info"
    mask_topic: "{name}_filter_mask"
    base: 0.0
    multiplier: 1.0
"""
        filters += f"""\
      {name}_filter:
        plugin: "{plugin}"
        enabled: true
        filter_info_topic: "{name}_costmap_filter_info"
{speed_topic}"""
    listed = ", ".join(f'"{name}_filter"' for name in masks)
    nodes = ", ".join(f'"{name}"' for name in names)
    return f"""\
# Paste this into the parameters of nav2; a map_server and a costmap_filter_info_server run for each mask.
{servers}\
lifecycle_manager_costmap_filters:
  ros__parameters:
    autostart: true
    node_names: [{nodes}]
global_costmap:
  global_costmap:
    ros__parameters:
      filters: [{listed}]
{filters}"""
