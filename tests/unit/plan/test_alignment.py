"""Maps are aligned with plans by pairs or by walls, and plans are read as they are drawn."""

import ezdxf
import numpy as np
import pytest
from PIL import Image

from gridslam.errors import InputError
from gridslam.geometry import se2
from gridslam.io.maps import read_map, read_map_description, write_map
from gridslam.plan.alignment import align_points, align_walls, fit_pairs
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


@pytest.mark.parametrize("seed", range(5))
def test_pairs_give_back_motion_and_scale(seed):
    rng = np.random.default_rng(seed)
    pose, scale = np.array([*rng.uniform(-9, 9, 2), rng.uniform(-3, 3)]), rng.uniform(0.1, 40)
    here = rng.uniform(-10, 10, (2 + seed, 2))
    found, left = fit_pairs(here, se2.transform_points(pose, scale * here))
    assert found.pose == pytest.approx(pose)
    assert found.scale == pytest.approx(scale)
    assert left == pytest.approx(np.zeros(len(here)), abs=1e-9)
    assert found.transform(here) == pytest.approx(se2.transform_points(pose, scale * here))


def _write_dxf(path, lines, units=ezdxf.units.CM):
    drawing = ezdxf.new("R2010")
    drawing.header["$INSUNITS"] = units
    for begin, end in 100 * lines:
        drawing.modelspace().add_line(tuple(begin), tuple(end))
    drawing.modelspace().add_lwpolyline([(0, 0), (100, 0), (100, 50)], close=True)
    drawing.saveas(path)


def test_a_dxf_has_the_lengths_of_its_units(tmp_path):
    _write_dxf(tmp_path / "plan.dxf", LINES)
    plan = read_drawn_plan(tmp_path / "plan.dxf")
    assert plan.unit_m == pytest.approx(0.01)
    assert plan.lines[: len(LINES)] == pytest.approx(100 * LINES)
    assert plan.lines[len(LINES) :].tolist() == [[[0, 0], [100, 0]], [[100, 0], [100, 50]], [[100, 50], [0, 0]]]


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
    lines = read_drawn_plan(tmp_path / "plan.dxf").lines
    middles = lines.mean(axis=1)
    curves = (
        ((10, 5), 3.0, 3 * np.pi / 2),
        ((-10, 5), 2.0, 4 * np.pi),
        ((0, -20), 4.0, 8 * np.pi),
        ((1, 0), 1.0, np.pi),
    )
    left = np.ones(len(lines), bool)
    for centre, radius, length in curves:
        own = np.abs(np.hypot(*(middles - centre).T) - radius) < 0.01 * radius
        assert np.hypot(*(lines[own] - centre).reshape(-1, 2).T) == pytest.approx(radius, abs=0.01 * radius)
        assert np.hypot(*np.diff(lines[own], axis=1).reshape(-1, 2).T).sum() == pytest.approx(length, rel=0.01)
        left &= ~own
    assert lines[left].ravel() == pytest.approx([2, 0, 2, 4], abs=1e-9)
    assert (middles[np.hypot(*(middles - [10, 5]).T) < 3] > [10, 5]).all(), "a quarter, anticlockwise"
    assert (middles[np.hypot(*(middles - [1, 0]).T) < 1][:, 1] < 0).all(), "the bulge is to the right"


def test_a_dxf_may_state_no_unit(tmp_path):
    _write_dxf(tmp_path / "plan.dxf", LINES, units=0)
    assert read_drawn_plan(tmp_path / "plan.dxf").unit_m is None
    _write_dxf(tmp_path / "plan.dxf", LINES, units=99)
    with pytest.raises(InputError, match=r"plan\.dxf"):
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
    plan = read_drawn_plan(path)
    unit_m = {"dxf": 0.01, "png": 0.02}[kind]
    moved, fixed = points_of_grid(grid), plan.surfaces(unit_m)
    found = align_walls(moved, fixed, align_points(moved, fixed, True))
    corners = np.array([[0, 0], [10, 0], [10, 4], [0, 4]], float)
    assert found.transform(corners) == pytest.approx(se2.transform_points(pose, corners), abs=0.06)
    assert found.pose[2] == pytest.approx(0.6, abs=0.005)
    assert found.share > 0.9  # by either side of a line
    # Pairs that are picked 20 cm beside it are good enough, too, and correct a unit.
    there = se2.transform_points(pose, corners) + np.array([[0.2, 0], [-0.1, 0.2], [0, -0.2], [0.1, 0.1]])
    again = align_walls(moved, fixed, fit_pairs(corners, there)[0])
    assert again.transform(corners) == pytest.approx(found.transform(corners), abs=0.02)


@pytest.mark.parametrize("text", ["", "0\nSECTION", "<svg/>"])
def test_what_is_no_plan_is_refused_by_name(tmp_path, text):
    for name in ("plan.dxf", "plan.png"):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            read_drawn_plan(tmp_path / name)


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
