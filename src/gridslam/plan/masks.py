"""Masks of nav2's costmap filters: where robots may not go, should go, and how fast."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gridslam.errors import ArgumentError
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
        nav2's: 0 cost in percent of lethal, 1 speed in percent, 2 speed in m/s.
    multiplier : float
        Of the values: ``limit = multiplier * value``; 0 sets no limit.
    """

    values: NDArray[np.int8]
    kind: int
    multiplier: float = 1.0


def make_keepout_mask(grid: OccupancyGrid, edits: Edits, off_lane_percent: int = 50) -> Mask:
    """Draw keep-out polygons and no-go lines with 100; where there are lanes, cells beside them cost more.

    Parameters
    ----------
    grid : OccupancyGrid
        The map, whose cells the mask has.
    edits : Edits
    off_lane_percent : int, 0 to 99
        Cost beside lanes, in percent of a lethal one; in lanes it is 0.
    """
    values = np.zeros(grid.shape, np.int8)
    lanes = edits.of("lanes")
    if lanes:
        values[:] = off_lane_percent
    for chosen, value in ((lanes, 0), (edits.of("keep_out", "no_go"), 100)):
        for edit in chosen:
            window, inside = cells_of(edit, grid)
            values[window][inside] = value
    return Mask(values, 0)


def make_speed_mask(grid: OccupancyGrid, edits: Edits) -> Mask | None:
    """Draw speed zones; where they overlap the lowest limit holds. Those in m/s are rounded down to 1 % of the highest.

    Returns None without zones.

    Raises
    ------
    ArgumentError
        Some zones have limits in percent and some in m/s: a mask of nav2 has one unit.
    """
    zones = edits.of("speed")
    limits = [dict(edit.limits or {}) for edit in zones]
    units = {unit for limit in limits for unit in limit}
    if not zones:
        return None
    if len(units) != 1:
        raise ArgumentError("speed zones", "limits in percent or in m/s, not both", " and ".join(sorted(units)))
    (unit,) = units
    multiplier = 1.0 if unit == "limit_percent" else max(limit[unit] for limit in limits) / 100
    values = np.full(grid.shape, 127, np.int8)
    for edit, limit in zip(zones, limits, strict=True):
        window, inside = cells_of(edit, grid)
        value = max(1, int(limit[unit] / multiplier + 1e-6))
        values[window][inside] = np.minimum(values[window][inside], np.int8(value))
    values[values == 127] = 0
    return Mask(values, 1 if unit == "limit_percent" else 2, multiplier)


def write_mask(yaml_path: Path, mask: Mask, grid: OccupancyGrid, mode: str = "scale") -> None:
    """Write a mask as an image and its YAML file, from which map_server reads exactly its values.

    Parameters
    ----------
    yaml_path : Path
        The image is a PGM of the same name beside it.
    mask : Mask
    grid : OccupancyGrid
        The map, whose place the mask has.
    mode : str
        "scale": white is 0, black 100; "raw": a pixel is its value.
    """
    values = mask.values[::-1]
    pixels = values.astype(np.uint8) if mode == "raw" else np.rint(255 * (1 - values / 100)).astype(np.uint8)
    image = yaml_path.with_suffix(".pgm")
    Image.fromarray(pixels).save(image)
    x, y = (float(value) for value in grid.origin)
    text = MapDescription(image.name, float(grid.resolution_m), (x, y), False, 1.0, 0.0, mode).to_yaml()
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
    multiplier: {mask.multiplier!r}
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
