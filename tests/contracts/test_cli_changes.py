"""What `gridslam changes` finds between two maps, and what it refuses."""

import json
from functools import partial

import numpy as np
import pytest
from PIL import Image

from gridslam.io.maps import write_map
from support.drawn_maps import TABLE, draw_two_rooms

MOVED = (3.6, 0.8, 5.0, 1.6)


@pytest.fixture
def call(call):
    return partial(call, "changes")


@pytest.fixture(scope="module")
def days(tmp_path_factory):
    """Maps of three days: with the table, with the table elsewhere, and that in another frame."""
    folder = tmp_path_factory.mktemp("days")
    write_map(folder / "monday.yaml", draw_two_rooms())
    write_map(folder / "tuesday.yaml", draw_two_rooms(table=MOVED))
    turned = draw_two_rooms(np.deg2rad(33.0), table=MOVED)
    away = type(turned)(
        turned.log_odds, turned.known, turned.resolution_m, (turned.origin[0] + 7, turned.origin[1] - 3)
    )
    write_map(folder / "wednesday.yaml", away)
    return folder


def _middle(box):
    return [(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]


@pytest.mark.parametrize("second", ["tuesday", "wednesday"])
def test_what_was_moved_has_gone_and_is_new(call, days, tmp_path, second):
    status, out, err = call(days / "monday.yaml", days / f"{second}.yaml", "-o", tmp_path, "--json")
    assert (status, err) == (0, "")
    document = json.loads(out)
    assert sorted(change["kind"] for change in document["changes"]) == ["gone", "new"]
    for change in document["changes"]:
        assert change["middle_m"] == pytest.approx(_middle(TABLE if change["kind"] == "gone" else MOVED), abs=0.1)
        assert np.mean(change["outline_m"], axis=0) == pytest.approx(change["middle_m"], abs=0.01)
        assert 1.4 * 0.8 <= change["area_m2"] <= 1.5 * 0.9  # a cell more at each end, where it lies askew
    pose = document["second_in_first"]
    if second == "wednesday":
        back = np.deg2rad(-33.0)
        turn = np.array([[np.cos(back), -np.sin(back)], [np.sin(back), np.cos(back)]])
        assert pose[2] == pytest.approx(back, abs=0.005)
        assert pose[:2] == pytest.approx(-turn @ [7, -3], abs=0.06)
    with Image.open(tmp_path / "changes.png") as image:
        maps = image.convert("RGB").crop((0, 0, image.width, image.height * 3 // 4))  # without the keys
        colours = {colour for _, colour in maps.getcolors(1 << 20)}
    assert {(214, 40, 40), (0, 130, 90)} <= colours


def test_of_one_day_nothing_has_changed(call, days, tmp_path):
    status, out, _ = call(days / "monday.yaml", days / "monday.yaml", "-o", tmp_path, "--json", "--same-frame")
    assert status == 0
    assert json.loads(out)["changes"] == []


def test_what_one_day_has_not_seen_is_left_open(call, days, tmp_path):
    grid = draw_two_rooms(table=MOVED)
    known = grid.known.copy()
    x = grid.origin[0] + (np.arange(grid.shape[1]) + 0.5) * grid.resolution_m
    known[:, (x > 1.8) & (x < 3.5)] = False  # about where the table was
    write_map(tmp_path / "half.yaml", type(grid)(grid.log_odds, known, grid.resolution_m, grid.origin))
    _, out, _ = call(days / "monday.yaml", tmp_path / "half.yaml", "-o", tmp_path / "out", "--json")
    assert [change["kind"] for change in json.loads(out)["changes"]] == ["new"]


def test_a_map_of_another_place_is_refused(call, days, tmp_path):
    rng = np.random.default_rng(0)
    other = draw_two_rooms(table=None, door=None)
    noise = rng.random(other.shape) < 0.02
    grid = type(other)(
        np.where(noise, 4.0, -4.0).astype(np.float32), np.ones(other.shape, np.bool_), 0.05, other.origin
    )
    write_map(tmp_path / "other.yaml", grid)
    status, out, err = call(days / "monday.yaml", tmp_path / "other.yaml", "-o", tmp_path / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "other.yaml" in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["missing.yaml", "free.yaml"])
def test_what_is_no_map_is_one_line(call, days, tmp_path, name):
    grid = draw_two_rooms()
    write_map(tmp_path / "free.yaml", type(grid)(0 * grid.log_odds - 4, grid.known, 0.05, (0.0, 0.0)))
    for pair in ((days / "monday.yaml", tmp_path / name), (tmp_path / name, days / "monday.yaml")):
        status, out, err = call(*pair, "-o", tmp_path / "out")
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert name in err
        assert not (tmp_path / "out").exists()
