"""Maps whose origin has a yaw: each cell is where map_server has it."""

import math

import numpy as np
import pytest

from gridslam.errors import InputError
from gridslam.geometry.se2 import compose
from gridslam.io.maps import MapDescription, read_map
from gridslam.io.turned_maps import count_turned_cells, turn_cells

CORNER = (-1.5, 2.0)
CELL_M = 0.1


def numbered(height=7, width=11):
    """Cells that are all different, none of them 0."""
    return np.arange(1, height * width + 1, dtype=np.int32).reshape(height, width)


def centres(cells, corner):
    """Where the centre (x, y) of each cell is, by its value."""
    return {
        value: (corner[0] + CELL_M * (column + 0.5), corner[1] + CELL_M * (row + 0.5))
        for (row, column), value in np.ndenumerate(cells)
        if value
    }


def expected(cells, yaw):
    """Where map_server has them: the origin is the pose of the lower left corner."""
    frame = np.array([*CORNER, yaw])
    own = centres(cells, (0.0, 0.0))
    return {value: compose(frame, np.array([*place, 0.0]))[:2] for value, place in own.items()}


@pytest.mark.parametrize("yaw", [math.pi / 2, -math.pi / 2, math.pi, -3.14159, 1.5708])
def test_quarter_turns_give_each_cell_another_place(yaw):
    cells = numbered()
    turned, corner = turn_cells(cells, CELL_M, CORNER, yaw, 0)
    assert sorted(turned.ravel().tolist()) == sorted(cells.ravel().tolist())
    found = centres(turned, corner)
    for value, place in expected(cells, yaw).items():
        np.testing.assert_allclose(found[value], place, atol=1e-4)


@pytest.mark.parametrize("yaw", [0.3, -2.0, math.pi / 4, 3.0])
def test_other_turns_move_nothing_by_more_than_half_a_diagonal(yaw):
    cells = numbered()
    turned, corner = turn_cells(cells, CELL_M, CORNER, yaw, 0)
    there = expected(cells, yaw)
    found = centres(turned, corner)
    assert len(found) > 0.75 * cells.size
    for value, place in found.items():
        assert math.dist(place, there[value]) <= CELL_M * math.sqrt(0.5) + 1e-9
    assert np.count_nonzero(turned) == pytest.approx(cells.size, rel=0.15)


def test_what_lies_outside_is_unknown():
    turned, _ = turn_cells(np.ones((4, 4), np.int8), CELL_M, CORNER, math.pi / 4, -1)
    assert turned[0, 0] == turned[-1, -1] == -1
    assert turned.size == count_turned_cells((4, 4), math.pi / 4)
    assert set(turned.ravel().tolist()) == {1, -1}


@pytest.mark.parametrize("written", ["-3.14159", "0.7", "6.2"])
def test_a_map_with_a_yaw_is_read_with_a_remark(tmp_path, written):
    (tmp_path / "map.pgm").write_bytes(b"P5\n3 2\n255\n" + bytes([0, 254, 205, 254, 254, 205]))
    text = MapDescription("map.pgm", 1.0, (10.0, 20.0)).to_yaml().replace("20.0, 0.0]", f"20.0, {written}]")
    (tmp_path / "map.yaml").write_text(text)
    told = []
    grid = read_map(tmp_path / "map.yaml", on_remark=told.append)
    yaw = math.remainder(float(written), 2 * math.pi)
    assert told == [f"the map is turned by {math.degrees(yaw):.4g} degrees about its corner, as its origin states"]
    row, column = np.argwhere(grid.known & (grid.log_odds > 1))[0]
    place = compose(np.array([10.0, 20.0, yaw]), np.array([0.5, 1.5, 0.0]))[:2]  # the wall: the first pixel of the top
    found = grid.origin[0] + column + 0.5, grid.origin[1] + row + 0.5
    assert math.dist(found, place) < 0.71


def test_a_description_with_a_yaw_is_written_as_it_was_read(tmp_path):
    description = MapDescription("map.pgm", 0.05, (1.0, 2.0), yaw_rad=0.5)
    assert "origin: [1.0, 2.0, 0.5]" in description.to_yaml()


def test_a_long_map_that_turned_would_fill_the_memory_is_refused(tmp_path):
    (tmp_path / "map.pgm").write_bytes(b"P5\n60000 1\n255\n" + bytes(60000))
    text = MapDescription("map.pgm", 0.05, (0.0, 0.0), yaw_rad=math.pi / 4).to_yaml()
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(InputError, match=r"turned by 0\.785398 rad, takes 14\.4 GB of memory"):
        read_map(tmp_path / "map.yaml")
