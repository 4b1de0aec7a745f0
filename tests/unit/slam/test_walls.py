"""Walls are the long lines that beams end on; furniture is not."""

import numpy as np
import pytest

from gridslam.matching.lines import measure_line_lengths
from gridslam.slam.loop_closure.walls import find_walls, leave_open
from gridslam.types import StoredScan
from support.oblong import map_room, scan_at

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


def test_what_stands_before_a_wall_is_no_part_of_its_line():
    wall, box = line(-3, 2, 3, 2), line(-0.4, 1.7, 0.4, 1.7)
    seen = wall[np.abs(wall[:, 0] / wall[:, 1]) > 0.4 / 1.7]  # the rest is hidden
    ends = np.concatenate([seen, box])
    scan = StoredScan(ends[np.argsort(np.arctan2(ends[:, 1], ends[:, 0]))], ORIGIN)
    lengths = measure_line_lengths(scan.ends, ORIGIN)
    assert (lengths[scan.ends[:, 1] > 1.9] > 2).mean() > 0.9
    assert lengths[scan.ends[:, 1] < 1.8].max() < 1


def test_walls_of_one_direction_leave_a_place_beside_open_and_those_of_a_room_do_not():
    maps, pose = map_room(), np.zeros(3)
    ends = scan_at(pose).ends
    assert not leave_open(maps, ends, pose)
    parallel = ends[(np.abs(ends[:, 1]) > 2) & (np.abs(ends[:, 0]) < 1.5)]
    assert leave_open(maps, parallel, pose)
