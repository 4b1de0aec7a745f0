"""Round walls of a plan are arcs, straight ones are none; and files have them as arcs."""

import json
import re

import ezdxf
import numpy as np
import pytest

from gridslam.plan import make_plan, points_of_scans
from gridslam.plan.drawing import draw_plan
from gridslam.plan.exports import write_dxf, write_geojson
from gridslam.plan.sheet import write_pdf, write_svg
from gridslam.types import OccupancyGrid

CENTRE = np.array([0.3, -0.2])
RADIUS_M = 3.0
CORRIDOR_M = 7.0
CELL_M = 0.05


def is_inside(places, corners, grown=0.0):
    """Whether places are in a room of so many corners, round with none, or in the corridor that leads to the right."""
    u, v = np.moveaxis(places - CENTRE, -1, 0)
    reach = np.hypot(u, v)
    if corners:
        side = 2 * np.pi / corners
        reach = reach * np.cos((np.arctan2(v, u) + side / 2) % side - side / 2)
    return (reach < RADIUS_M + grown) | ((np.abs(v) < 1.0 + grown) & (u > 0) & (u < CORRIDOR_M + grown))


def draw(corners=0):
    """The room's map: occupied for a cell and a half about it."""
    x, y = np.meshgrid(*(np.arange(-5.0, 10.0, CELL_M) + CELL_M / 2,) * 2)
    places = np.stack([x, y], axis=-1)
    free, near = is_inside(places, corners), is_inside(places, corners, 1.5 * CELL_M)
    log_odds = np.where(free, -4.0, np.where(near, 4.0, 0.0)).astype(np.float32)
    return OccupancyGrid(log_odds, near, CELL_M, (-5.0, -5.0))


def see(corners=0):
    """End points, with noise of 1 cm, from five places in the room."""
    rng = np.random.default_rng(0)
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    scans = []
    for origin in CENTRE + np.array([[0, 0], [1, 0.5], [-1, 0.5], [0.5, -1.0], [2.5, 0.0]]):
        along = np.arange(0.0, 11.0, 0.004)[:, None, None] * rays + origin
        lengths = 0.004 * np.argmin(is_inside(along, corners), axis=0) + rng.normal(0, 0.01, len(rays))
        scans.append((origin, origin + lengths[:, None] * rays))
    return points_of_scans(scans, CELL_M)


@pytest.fixture(scope="module")
def plan():
    return make_plan(draw(), see())


@pytest.mark.parametrize("is_scanned", [False, True])
def test_a_round_room_has_an_arc(plan, is_scanned):
    found = plan if is_scanned else make_plan(draw())
    (arc,) = found.arcs
    assert arc.is_concave
    assert arc.centre == pytest.approx(CENTRE, abs=0.02)
    assert arc.radius_m == pytest.approx(RADIUS_M, abs=0.02 if is_scanned else 0.05)
    opening = 2 * np.arcsin(1.0 / RADIUS_M)
    assert arc.end - arc.begin == pytest.approx(2 * np.pi - opening, abs=0.15)
    assert arc.begin % (2 * np.pi) == pytest.approx(opening / 2, abs=0.1)
    (room,) = found.rooms
    whole = np.pi * RADIUS_M**2 + 2 * (CORRIDOR_M - RADIUS_M)
    assert room.area_m2 == pytest.approx(whole, rel=0.012 if is_scanned else 0.03)
    assert sum(wall.length_m for wall in found.walls) == pytest.approx(2 + 2 * (CORRIDOR_M - RADIUS_M), abs=0.8)


@pytest.mark.parametrize("is_scanned", [False, True])
@pytest.mark.parametrize("corners", [4, 8, 12])
def test_a_room_of_straight_sides_has_none(corners, is_scanned):
    assert not make_plan(draw(corners), see(corners) if is_scanned else None).arcs


def test_a_round_wall_that_was_seen_through_a_window_is_left_out():
    """Only its ends are at the room; the chord between them, along the wall of the room, does not count."""
    x, y = np.meshgrid(*(np.arange(-5.0, 10.0, CELL_M) + CELL_M / 2,) * 2)
    far, apart = np.maximum(np.abs(x), np.abs(y)), np.hypot(x, y - 3.0)
    is_beyond = y > 3.0 + CELL_M
    free = (far < 3.0) | (is_beyond & (np.abs(apart - 1.95) < 0.05))
    known = free | (far < 3.0 + CELL_M) | (is_beyond & (np.abs(apart - 2.05) <= 0.05))
    log_odds = np.where(free, -4.0, np.where(known, 4.0, 0.0)).astype(np.float32)
    plan = make_plan(OccupancyGrid(log_odds, known, CELL_M, (-5.0, -5.0)))
    assert plan.rooms[0].area_m2 == pytest.approx(36.0, rel=0.03)
    assert not plan.arcs
    assert plan.bounds[1, 1] < 3.2


def test_arcs_turn_with_their_plan(plan):
    (arc,), (turned,) = plan.arcs, plan.turn(0.3).arcs
    c, s = np.cos(0.3), np.sin(0.3)
    assert turned.points(0.01) == pytest.approx(arc.points(0.01) @ np.array([[c, s], [-s, c]]))
    assert plan.turn(np.pi / 2).bounds[1, 1] > 6.5


def test_files_have_arcs(plan, tmp_path):
    """DXF and SVG as what they are, both halves of it, GeoJSON as lines that are nowhere 5 mm off."""
    (arc,) = plan.arcs
    write_dxf(tmp_path / "plan.dxf", plan)
    drawing = ezdxf.readfile(tmp_path / "plan.dxf")
    assert not drawing.audit().has_errors
    halves = drawing.modelspace().query("ARC")
    assert [half.dxf.layer for half in halves] == ["WALLS"] * 2
    assert [half.dxf.radius for half in halves] == pytest.approx([arc.radius_m] * 2)
    assert halves[0].dxf.start_angle == pytest.approx(np.rad2deg(arc.begin) % 360)
    assert halves[1].dxf.end_angle == pytest.approx(np.rad2deg(arc.end) % 360)
    sheet = draw_plan(plan, "round", 50)
    write_svg(tmp_path / "plan.svg", sheet)
    paths = re.findall(
        r'd="M([\d.]+) ([\d.]+) A([\d.]+) \3 0 0 0 ([\d.]+) ([\d.]+)"', (tmp_path / "plan.svg").read_text()
    )
    assert len(paths) == 2
    (first, second) = (np.array(path, float) for path in paths)
    assert first[2] == pytest.approx(arc.radius_m * 20, abs=0.01)
    assert first[3:] == pytest.approx(second[:2], abs=0.02)
    write_pdf(tmp_path / "plan.pdf", sheet)
    write_geojson(tmp_path / "plan.geojson", plan, "round")
    (line,) = (
        feature
        for feature in json.loads((tmp_path / "plan.geojson").read_text())["features"]
        if "radius_m" in feature["properties"]
    )
    assert line["properties"] == {
        "layer": "walls",
        "length_m": pytest.approx(arc.length_m, abs=0.001),
        "radius_m": pytest.approx(arc.radius_m, abs=0.001),
    }
    corners = np.array(line["geometry"]["coordinates"])
    middles = (corners[1:] + corners[:-1]) / 2
    assert np.hypot(*(middles - arc.centre).T).min() > arc.radius_m - 0.0055
