"""Maps are aligned with plans by their walls, and plans are read as they are drawn."""

import numpy as np
import pytest
from PIL import Image

from gridslam.errors import InputError
from gridslam.geometry import se2
from gridslam.io.maps import read_map, read_map_description, write_map
from gridslam.plan.alignment import Alignment, align_points, align_walls
from gridslam.plan.drawn_plans import read_drawn_plan
from gridslam.plan.surfaces import points_of_grid
from support.drawn_maps import draw_two_rooms


def test_a_map_is_laid_on_a_turned_plan_by_its_walls(tmp_path):
    path = tmp_path / "plan.png"
    turned = draw_two_rooms(0.6, 0.02, table=None)
    Image.fromarray(np.where(turned.log_odds > 0, 0, 255).astype(np.uint8)[::-1]).save(path)
    pose = np.array([*-np.array(turned.origin), 0.6])
    moved = points_of_grid(draw_two_rooms(table=None))
    fixed = read_drawn_plan(path, 0.02)
    found = align_walls(moved, fixed, align_points(moved, fixed, True))
    corners = np.array([[0, 0], [10, 0], [10, 4], [0, 4]], float)
    assert found.transform(corners) == pytest.approx(se2.transform_points(pose, corners), abs=0.06)
    assert found.pose[2] == pytest.approx(0.6, abs=0.005)
    assert found.share > 0.9  # by either side of a line
    # A guess that is 20 cm and 2 % off is good enough, and a unit is corrected.
    guess = Alignment(pose + np.array([0.2, -0.1, 0.01]), np.inf, 0.0, 1.02)
    again = align_walls(moved, fixed, guess)
    assert again.transform(corners) == pytest.approx(found.transform(corners), abs=0.02)


@pytest.mark.parametrize("text", ["", "<svg/>"])
def test_what_is_no_plan_is_refused_by_name(tmp_path, text):
    (tmp_path / "plan.png").write_text(text)
    with pytest.raises(InputError, match=r"plan\.png"):
        read_drawn_plan(tmp_path / "plan.png", 1.0)


def test_a_map_is_written_with_a_rotated_origin_and_read_where_it_lies(tmp_path):
    grid = draw_two_rooms()
    pose = np.array([3.0, -2.0, 0.4])
    write_map(tmp_path / "map.yaml", grid, pose, 1.5)
    description = read_map_description(tmp_path / "map.yaml")
    assert description.yaw_rad == pytest.approx(0.4)
    assert description.resolution_m == pytest.approx(1.5 * grid.resolution_m)
    assert description.origin == pytest.approx(se2.transform_points(pose, 1.5 * np.array([grid.origin]))[0])
    turned = read_map(tmp_path / "map.yaml")

    def walls(of):
        rows, columns = np.nonzero(of.log_odds > 0)
        return np.array(of.origin) + (np.column_stack([columns, rows]) + 0.5) * of.resolution_m

    apart = walls(turned)[:, None] - se2.transform_points(pose, 1.5 * walls(grid))[None]
    assert np.hypot(*apart.transpose(2, 0, 1)).min(axis=1).max() <= 0.7072 * turned.resolution_m
