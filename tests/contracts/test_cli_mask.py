"""What `gridslam mask` writes, how plans honour edits, and what is refused."""

import json

import numpy as np
import pytest

from gridslam.io.edits import Edit, Edits, read_edits, write_edits
from gridslam.io.maps import read_map, write_map
from support.drawn_maps import DOOR, draw_two_rooms

WALL = Edit("walls", "LineString", np.array([[3.0, -0.2], [3.0, 4.2]]), width_m=0.2)
ZONE = Edit("keep_out", "Polygon", np.array([[7.0, 1.0], [8.0, 1.0], [8.0, 2.0], [7.0, 2.0]]))
SLOW = Edit("speed", "Polygon", np.array([[0.5, 0.5], [2.0, 0.5], [2.0, 2.0]]), limit_percent=40.0)
NAMES = (
    Edit("rooms", "Point", np.array([[1.0, 3.0]]), "Lager"),
    Edit("rooms", "Point", np.array([[5.0, 3.0]]), "Flur"),
)


@pytest.fixture
def drawn(tmp_path):
    """A map of two rooms without furniture, and edits of it."""
    write_map(tmp_path / "rooms.yaml", draw_two_rooms(table=None))
    write_edits(tmp_path / "edits.geojson", Edits((WALL, ZONE, SLOW, *NAMES)))
    return tmp_path


def test_masks_and_the_edited_map_are_written(call, drawn):
    status, out, err = call("mask", drawn / "rooms.yaml", drawn / "edits.geojson", "-o", drawn / "out", "--json")
    assert (status, err) == (0, "")
    document = json.loads(out)
    assert document["layers"] == {"walls": 1, "keep_out": 1, "speed": 1, "rooms": 2}
    assert document["masks"]["keepout"]["area_m2"] == pytest.approx(1.05**2, rel=0.06)
    assert document["masks"]["speed"]["area_m2"] == pytest.approx(0.5 * 1.55 * 1.55, rel=0.05)
    before, after = read_map(drawn / "rooms.yaml"), read_map(drawn / "out" / "map.yaml")
    assert ((before.log_odds > 0) != (after.log_odds > 0)).sum() == document["changed_cells"] > 200
    assert {file.name for file in (drawn / "out").iterdir()} == {
        "map.yaml", "map.pgm", "keepout_mask.yaml", "keepout_mask.pgm", "speed_mask.yaml", "speed_mask.pgm",
        "edits.geojson", "mask.json",
    }  # fmt: skip
    written = read_edits(drawn / "out" / "edits.geojson")
    assert (drawn / "out" / written.map_name).resolve() == drawn / "rooms.yaml"
    assert call("mask", drawn / "rooms.yaml", drawn / "out" / "edits.geojson", "-o", drawn / "again")[0] == 0
    assert (drawn / "again" / "map.pgm").read_bytes() == (drawn / "out" / "map.pgm").read_bytes()


def test_a_plan_has_walls_that_were_drawn_and_the_names_of_rooms(call, drawn):
    call("mask", drawn / "rooms.yaml", drawn / "edits.geojson", "-o", drawn / "out")
    status, out, _ = call("plan", drawn / "out" / "map.yaml", "-o", drawn / "plan", "--json")
    assert status == 0
    rooms = {room["name"]: room["area_m2"] for room in json.loads(out)["rooms"]}
    assert rooms["Lager"] == pytest.approx(2.9 * 4, rel=0.04)
    assert rooms["Flur"] == pytest.approx(2.9 * 4, rel=0.04)
    assert len(rooms) == 3


def test_an_erased_wall_joins_two_rooms(call, drawn):
    x, _, x2, _ = DOOR
    gap = Edit("erased", "Polygon", np.array([[x - 0.1, 0.1], [x2 + 0.1, 0.1], [x2 + 0.1, 3.9], [x - 0.1, 3.9]]))
    write_edits(drawn / "gap.geojson", Edits((gap,)))
    call("mask", drawn / "rooms.yaml", drawn / "gap.geojson", "-o", drawn / "out")
    rooms = json.loads(call("plan", drawn / "out" / "map.yaml", "-o", drawn / "plan", "--json")[1])["rooms"]
    assert [room["area_m2"] for room in rooms] == pytest.approx([10 * 4], rel=0.04)


def test_edits_of_another_place_are_one_line(call, drawn):
    write_edits(drawn / "wrong.geojson", Edits((Edit("keep_out", "Polygon", ZONE.points + 99),)))
    status, out, err = call("mask", drawn / "rooms.yaml", drawn / "wrong.geojson", "-o", drawn / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "feature 1: expected places in" in err
    assert "wrong.geojson" in err
    assert not (drawn / "out").exists()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"type": "FeatureCollection"}'])
def test_what_is_no_edit_file_is_one_line(call, drawn, text):
    (drawn / "wrong.geojson").write_text(text)
    status, out, err = call("mask", drawn / "rooms.yaml", drawn / "wrong.geojson", "-o", drawn / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "wrong.geojson" in err


def test_the_map_itself_is_never_replaced(call, drawn):
    before = (drawn / "rooms.pgm").read_bytes()
    status, _, err = call("mask", drawn / "rooms.yaml", drawn / "edits.geojson", "-o", drawn)
    assert (status, err.count("\n")) == (2, 1)
    assert "expected another folder than that of the map" in err
    assert (drawn / "rooms.pgm").read_bytes() == before
