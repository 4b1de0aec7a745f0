"""Places that furniture alone distinguishes from those beside: it is moved, as walls are not."""

from __future__ import annotations

import numpy as np

from gridslam.geometry.se2 import between
from gridslam.grid.tiles import TileMaps
from gridslam.matching.branch_and_bound import thin_points
from gridslam.matching.gauss_newton import weigh_known_beams
from gridslam.matching.lines import measure_line_lengths
from gridslam.slam.loop_closure.submaps import DIRECTIONS, ROW, match_points
from gridslam.types import BeamEnds, FloatArray

_WALL_M = 2.0
"""Lines longer than furniture and doors are walls."""
_BESIDE_M = 0.75
"""Furniture is moved about so far where all that scans see of it fits again."""
_SAME_M = 0.3
MOST_BESIDE_M = 1.5
"""Places nearer to each other are one, and those farther off are not beside."""
_RATIO = 0.9
"""Most evidence of walls for a place beside, as a fraction of that for the place."""
_NEUTRAL = 0.7
"""Agreement that is no evidence, as in `score_trajectory`."""
_AGREES_M = 0.1
_MOST_POINTS = 1000


def find_walls(scan: BeamEnds) -> FloatArray:
    """Return the ends (B, 2) of the beams that end on long lines."""
    return scan.ends[measure_line_lengths(scan.ends, np.asarray(scan.origin)) >= _WALL_M]


def leave_open(maps: TileMaps, walls: FloatArray, pose: FloatArray) -> bool:
    """Return whether walls fit the one map beside a pose as well as there: furniture alone decides then.

    Scans that see hardly anything else fit it where it stands now, all the more where all of it was moved alike.

    Parameters
    ----------
    maps : TileMaps
        One map.
    walls : (B, 2) float64
        Ends of beams on walls.
    pose : (3,) float64
        Where their frame is in the map.
    """
    few = thin_points(walls, _MOST_POINTS)
    places = match_points(maps, pose + _BESIDE_M * DIRECTIONS, few).poses
    away = np.hypot(*between(pose, places)[:, :2].T)
    limit = _RATIO * _weigh(maps, few, pose)
    beside = places[(away >= _SAME_M) & (away < MOST_BESIDE_M)]
    return any(_weigh(maps, few, place) > max(limit, 0.0) for place in beside)


def _weigh(maps: TileMaps, points: FloatArray, pose: FloatArray) -> float:
    weights = weigh_known_beams(maps, ROW, pose, points, _AGREES_M)
    return float(weights.sum(dtype=np.float64)) - _NEUTRAL * len(weights)
