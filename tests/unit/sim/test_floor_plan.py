"""Walls, doors and distances to them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridslam.errors import ArgumentError
from gridslam.sim.floor_plan import (
    box,
    carve,
    clearance,
    furniture,
    join,
    near,
    pillar,
    place,
    polyline,
    room,
    wall,
)


def _length(walls):
    return np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]).sum()


def test_wall_with_doors_keeps_its_thickness_and_leaves_the_openings_free():
    walls = wall((1, 2), (1, 12), [(3.0, 1.0), (8.0, 2.0)], thickness_m=0.2)
    assert walls.shape == (12, 4)  # three pieces of four faces
    assert _length(walls) == pytest.approx(2 * (10 - 3) + 6 * 0.2)
    middles = np.array([[1.0, 5.0], [1.0, 10.0], [1.0, 7.0]])
    assert clearance(walls, middles) == pytest.approx([0.5, 1.0, 0.1])


def test_door_at_the_end_of_a_wall_leaves_one_piece():
    assert len(wall((0, 0), (4, 0), [(0.5, 1.0)])) == 4


@pytest.mark.parametrize("doors", [[(0.2, 1.0)], [(3.9, 1.0)], [(1.0, 1.0), (1.5, 1.0)], [(3.0, 1.0), (1.0, 1.0)]])
def test_door_beyond_the_wall_or_over_another_is_refused(doors):
    with pytest.raises(ArgumentError, match="doors"):
        wall((0, 0), (4, 0), doors)


def test_room_opens_where_it_has_doors():
    walls = room(0, 0, 6, 4, south=[(2.0, 1.0)], east=[(1.0, 0.8)])
    on_walls = np.array([[2.0, 0.0], [6.0, 1.0], [3.0, 4.0], [0.0, 2.0]])
    assert clearance(walls, on_walls) == pytest.approx([0.5, 0.4, 0.06, 0.06])


def test_room_names_the_side_it_does_not_have():
    with pytest.raises(ArgumentError, match="southeast"):
        room(0, 0, 6, 4, southeast=[(2.0, 1.0)])


def test_polyline_needs_two_points():
    with pytest.raises(ArgumentError, match="points"):
        polyline([(0.0, 0.0)])


def test_pillar_and_furniture_are_where_and_as_large_as_said():
    assert np.hypot(*(pillar(3, 4, 0.5)[:, :2] - [3, 4]).T) == pytest.approx(np.full(16, 0.5))
    table = furniture(1, 1, 2.0, 0.5, np.pi / 2)
    assert np.ptp(table[:, [0, 2]]) == pytest.approx(0.5)
    assert np.ptp(table[:, [1, 3]]) == pytest.approx(2.0)


def test_place_turns_then_shifts():
    assert place(polyline([(1, 0), (2, 0)]), (5.0, 5.0, np.pi / 2)) == pytest.approx(np.array([[5, 6, 5, 7]]))


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


def test_carved_spaces_that_touch_but_for_rounding_are_open_to_each_other():
    walls = carve([(0, 0, 0.1 + 0.2, 1), (0.3, 0, 1, 1)])
    assert _length(walls) == pytest.approx(4.0)


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


def test_carving_takes_rectangles():
    with pytest.raises(ArgumentError, match="spaces"):
        carve([(0, 0), (1, 1)])


@given(st.integers(0, 2**32 - 1), st.floats(0, 5))
def test_walls_that_are_left_out_are_not_near(seed, reach):
    rng = np.random.default_rng(seed)
    walls, points = rng.uniform(-10, 10, (20, 4)), rng.uniform(-3, 3, (5, 2))
    some = near(walls, points, reach)
    left_out = [wall for wall in walls.tolist() if wall not in some.tolist()]
    assert len(some) + len(left_out) == 20
    assert all(clearance(np.array([wall]), points).min() > reach for wall in left_out)
