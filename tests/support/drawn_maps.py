"""Maps drawn by hand, whose walls are known to the cell: two rooms with a door between them, and a table."""

from __future__ import annotations

import numpy as np

from gridslam.types import OccupancyGrid

ROOMS = (0.0, 0.0, 6.0, 4.0), (6.15, 0.0, 10.0, 4.0)
"""Left, bottom, right and top of the free space of both, m; the wall between them is 15 cm thick."""
DOOR = (6.0, 1.5, 6.15, 2.5)
TABLE = (2.0, 1.5, 3.4, 2.3)


def draw_two_rooms(angle_rad=0.0, resolution_m=0.05, table=TABLE, door=DOOR, margin_m=1.0) -> OccupancyGrid:
    """Free in rooms and door, occupied for 10 cm about them and for the table's edge, unknown elsewhere."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    corners = np.array([(x, y) for x in (0, 10) for y in (0, 4)]) @ np.array([[c, s], [-s, c]])
    low = np.floor((corners.min(axis=0) - margin_m) / resolution_m) * resolution_m
    width, height = np.ceil((corners.max(axis=0) + margin_m - low) / resolution_m).astype(int)
    x, y = np.meshgrid(
        low[0] + (np.arange(width) + 0.5) * resolution_m, low[1] + (np.arange(height) + 0.5) * resolution_m
    )
    u, v = x * c + y * s, y * c - x * s

    def inside(box, grown=0.0):
        return (u > box[0] - grown) & (u < box[2] + grown) & (v > box[1] - grown) & (v < box[3] + grown)

    spaces = [*ROOMS, *([door] if door else [])]
    free = np.any([inside(space) for space in spaces], axis=0)
    near = np.any([inside(space, 0.075) for space in spaces], axis=0) & ~free
    if table:
        free &= ~inside(table)
        near |= inside(table) & ~inside(table, -0.075)
    log_odds = np.where(near, 4.0, np.where(free, -4.0, 0.0)).astype(np.float32)
    return OccupancyGrid(log_odds, free | near, resolution_m, (float(low[0]), float(low[1])))
