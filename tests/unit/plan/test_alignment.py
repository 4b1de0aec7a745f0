"""Maps are aligned with plans by their walls, and plans are read as they are drawn."""

import ezdxf
import numpy as np
import pytest
from PIL import Image

from gridslam.errors import InputError
from gridslam.geometry import se2
from gridslam.io.maps import read_map, read_map_description, write_map
from gridslam.plan.alignment import Alignment, align_points, align_walls
from gridslam.plan.drawn_plans import read_drawn_plan
from gridslam.plan.surfaces import points_of_grid
from support.drawn_maps import ROOMS, draw_two_rooms

LINES = np.array(
    [
        side
        for x, y, x2, y2 in ROOMS
        for side in (
            [(x, y), (x2, y)], [(x2, y), (x2, y2)], [(x2, y2), (x, y2)], [(x, y2), (x, y)]
        )
    ],
    float,
)  # fmt: skip


def _write_dxf(path, lines, units=ezdxf.units.CM):
    drawing = ezdxf.new("R2010")
    drawing.header["$INSUNITS"] = units
    for begin, end in 100 * lines:
        drawing.modelspace().add_line(tuple(begin), tuple(end))
    drawing.modelspace().add_lwpolyline([(0, 0), (100, 0), (100, 50)], close=True)
    drawing.saveas(path)


def test_a_dxf_has_the_lengths_of_its_units(tmp_path):
    _write_dxf(tmp_path / "plan.dxf", LINES)
    points, unit_m = read_drawn_plan(tmp_path / "plan.dxf")
    assert unit_m == pytest.approx(0.01)
    room = (points.positions[:, 0] > 1.01) | (points.positions[:, 1] > 0.51)  # without the small triangle
    assert points.positions[room].max(axis=0) == pytest.approx(LINES.max(axis=(0, 1)))
    assert len(points) == pytest.approx(
        (np.hypot(*np.diff(LINES, axis=1)[:, 0].T).sum() + 1.5 + np.hypot(1, 0.5)) / 0.05, abs=3
    )


def test_curves_of_a_dxf_are_walls(tmp_path):
    drawing = ezdxf.new("R2010")
    drawing.units = ezdxf.units.M
    space = drawing.modelspace()
    space.add_arc((10, 5), 3.0, 0, 90)
    space.add_circle((-10, 5), 2.0)
    space.add_ellipse((0, -20), (4, 0), 1.0)
    space.add_lwpolyline([(0, 0, 1.0), (2, 0, 0.0), (2, 4, 0.0)], format="xyb")  # a half circle, and a line
    space.add_text("no wall")
    space.add_polymesh((3, 3))
    drawing.saveas(tmp_path / "plan.dxf")
    middles = read_drawn_plan(tmp_path / "plan.dxf")[0].positions
    curves = (
        ((10, 5), 3.0, 3 * np.pi / 2),
        ((-10, 5), 2.0, 4 * np.pi),
        ((0, -20), 4.0, 8 * np.pi),
        ((1, 0), 1.0, np.pi),
    )
    left = np.ones(len(middles), bool)
    for centre, radius, length in curves:
        own = np.abs(np.hypot(*(middles - centre).T) - radius) < 0.01 * radius
        assert own.sum() == pytest.approx(length / 0.05, rel=0.15)  # a point every 5 cm, one at least of each segment
        left &= ~own
    assert middles[left][:, 0] == pytest.approx(2)
    assert np.ptp(middles[left][:, 1]) == pytest.approx(4, abs=0.3)
    assert (middles[np.hypot(*(middles - [10, 5]).T) < 3.1] > [10, 5]).all(), "a quarter, anticlockwise"
    assert (middles[np.hypot(*(middles - [1, 0]).T) < 0.999][:, 1] < 0).all(), "the bulge is to the right"


@pytest.mark.parametrize(("units", "problem"), [(0, "state --unit"), (99, "DXF")])
def test_a_dxf_without_a_unit_needs_one(tmp_path, units, problem):
    _write_dxf(tmp_path / "plan.dxf", LINES, units=units)
    with pytest.raises(InputError, match=problem):
        read_drawn_plan(tmp_path / "plan.dxf")


@pytest.mark.parametrize("kind", ["dxf", "png"])
def test_a_map_is_laid_on_a_turned_plan_by_its_walls(tmp_path, kind):
    grid = draw_two_rooms(table=None)
    pose = np.array([12.0, 3.0, 0.6])
    lines = se2.transform_points(pose, LINES.reshape(-1, 2)).reshape(-1, 2, 2)
    lines[::2] = lines[::2, ::-1].copy()  # nobody draws them with the room to their left
    path = tmp_path / f"plan.{kind}"
    if kind == "dxf":
        _write_dxf(path, lines)
    else:
        turned = draw_two_rooms(0.6, 0.02, table=None)
        Image.fromarray(np.where(turned.log_odds > 0, 0, 255).astype(np.uint8)[::-1]).save(path)
        pose = np.array([*-np.array(turned.origin), 0.6])
    moved = points_of_grid(grid)
    fixed, _ = read_drawn_plan(path, {"dxf": None, "png": 0.02}[kind])
    found = align_walls(moved, fixed, align_points(moved, fixed, True))
    corners = np.array([[0, 0], [10, 0], [10, 4], [0, 4]], float)
    assert found.transform(corners) == pytest.approx(se2.transform_points(pose, corners), abs=0.06)
    assert found.pose[2] == pytest.approx(0.6, abs=0.005)
    assert found.share > 0.9  # by either side of a line
    # A guess that is 20 cm and 2 % off is good enough, and a unit is corrected.
    guess = Alignment(pose + np.array([0.2, -0.1, 0.01]), np.inf, 0.0, 1.02)
    again = align_walls(moved, fixed, guess)
    assert again.transform(corners) == pytest.approx(found.transform(corners), abs=0.02)


@pytest.mark.parametrize("text", ["", "0\nSECTION", "<svg/>"])
def test_what_is_no_plan_is_refused_by_name(tmp_path, text):
    for name in ("plan.dxf", "plan.png"):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            read_drawn_plan(tmp_path / name, 1.0)


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
