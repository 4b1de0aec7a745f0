"""Walls are the long lines that beams end on; furniture is not."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.matching.lines import measure_line_lengths
from gridslam.slam.loop_closure.walls import find_walls
from gridslam.types import StoredScan

ORIGIN = np.zeros(2)


def line(x0, y0, x1, y1):
    count = int(np.hypot(x1 - x0, y1 - y0) / 0.04)
    return np.column_stack([np.linspace(x0, x1, count), np.linspace(y0, y1, count)])


def test_each_beam_has_the_length_of_its_line():
    wall, box = line(-3, 2, 3, 2), line(-0.4, -1.5, 0.4, -1.5)
    ends = np.concatenate([wall, box])
    scan = StoredScan(ends[np.argsort(np.arctan2(ends[:, 1], ends[:, 0]))], ORIGIN)
    lengths = measure_line_lengths(scan.ends, ORIGIN)
    assert lengths[scan.ends[:, 1] > 0] == pytest.approx(6.0)
    assert lengths[scan.ends[:, 1] < 0] == pytest.approx(0.8)
    assert len(find_walls(scan)) == len(wall)
