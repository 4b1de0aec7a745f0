"""Walls, doors and distances to them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.sim.floor_plan import (
    box,
    clearance,
    join,
    polyline,
    room,
    wall,
)
from passages import carve


def _length(walls):
    return np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]).sum()


def test_wall_with_doors_keeps_its_thickness_and_leaves_the_openings_free():
    walls = wall((1, 2), (1, 12), [(3.0, 1.0), (8.0, 2.0)], thickness_m=0.2)
    assert walls.shape == (12, 4)  # three pieces of four faces
    assert _length(walls) == pytest.approx(2 * (10 - 3) + 6 * 0.2)
    middles = np.array([[1.0, 5.0], [1.0, 10.0], [1.0, 7.0]])
    assert clearance(walls, middles) == pytest.approx([0.5, 1.0, 0.1])


def test_room_names_the_side_it_does_not_have():
    with pytest.raises(ArgumentError, match="southeast"):
        room(0, 0, 6, 4, southeast=[(2.0, 1.0)])


def test_polyline_needs_two_points():
    with pytest.raises(ArgumentError, match="points"):
        polyline([(0.0, 0.0)])


def test_clearance_to_faces_and_corners_and_to_nothing():
    points = np.array([[1.0, 1.0], [-3.0, -4.0], [2.0, 7.0]])
    assert clearance(box(0, 0, 4, 3), points) == pytest.approx([1.0, 5.0, 4.0])
    assert np.isinf(clearance(join(), points)).all()


def test_carved_room_and_corridor_by_hand():
    """A room of 2 m x 2 m above a corridor, with a doorway 1 m wide through a wall of 0.1 m."""
    walls = carve([(0, 0, 6, 1), (1.5, 1, 2.5, 1.1), (3, 3.1, 1, 1.1)])
    assert _length(walls) == pytest.approx((6 + 1 + 1 + 6 - 1) + 2 * 0.1 + (2 - 1 + 2 + 2 + 2))
    assert len(walls) == 12  # those in one line are one, but for the doorway
    assert clearance(walls, np.array([[2.0, 1.05], [2.0, 0.5], [2.0, 2.1]])) == pytest.approx([0.5, 0.5, 1.0])


corners = st.integers(0, 8)


@given(st.lists(st.tuples(corners, corners, corners, corners), min_size=1, max_size=8))
def test_carved_walls_stand_between_free_and_solid_and_nowhere_else(spaces):
    """A ray along a row of cells is in free space after an odd number of walls."""
    walls = carve(spaces)
    centres = np.arange(8) + 0.5
    x, y = np.meshgrid(centres, centres)
    free = np.zeros((8, 8), bool)
    for x0, y0, x1, y1 in spaces:
        free |= (min(x0, x1) < x) & (x < max(x0, x1)) & (min(y0, y1) < y) & (y < max(y0, y1))
    for horizontal in (True, False):
        a, b, c, d = (walls if horizontal else walls[:, [1, 0, 3, 2]]).T
        here, there = (x, y) if horizontal else (y, x)
        crossed = (b < there[..., None]) & (there[..., None] < d) & (a == c) & (a < here[..., None])
        assert np.array_equal(crossed.sum(axis=-1) % 2 == 1, free)
