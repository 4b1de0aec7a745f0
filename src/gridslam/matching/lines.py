"""Straight lines that the beams of a scan end on, and how long they are."""

from __future__ import annotations

import numpy as np

from gridslam.types import FloatArray

_MOST_AWAY_M = 0.06
"""Distance of an end from its line, at most."""
_GAP_M = 0.5
"""Ends of neighbouring beams farther apart are on different lines, unless the beams are far apart there."""
_GAP_RATIO = 0.15


def measure_line_lengths(ends: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the length (B,) of the line that each beam ends on, m: split and merge without the merging.

    Parameters
    ----------
    ends : (B, 2) float64, m
        Ends of the beams of a scan, in the order of their bearings.
    origin : (2,) float64, m
        Where the laser is.

    References
    ----------
    Nguyen et al., A comparison of line extraction algorithms using 2D laser rangefinder (IROS 2005).
    """
    lengths = np.zeros(len(ends))
    if len(ends) < 2:
        return lengths
    ranges = np.hypot(*(ends - origin).T)
    steps = np.hypot(*np.diff(ends, axis=0).T)
    cuts = np.flatnonzero(steps > _GAP_M + _GAP_RATIO * np.minimum(ranges[1:], ranges[:-1])) + 1
    left = list(zip([0, *cuts.tolist()], [*cuts.tolist(), len(ends)], strict=True))
    while left:
        first, last = left.pop()
        along = ends[last - 1] - ends[first]
        length = float(np.hypot(*along))
        own = ends[first:last] - ends[first]
        away = np.abs(own[:, 0] * along[1] - own[:, 1] * along[0]) / max(length, 1e-9)
        worst = int(away.argmax())
        if away[worst] <= _MOST_AWAY_M or last - first <= 2:
            lengths[first:last] = length
        else:
            left += [(first, first + worst + 1), (first + worst, last)]
    return lengths
