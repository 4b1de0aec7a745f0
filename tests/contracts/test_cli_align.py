"""What `gridslam align` writes and reports, and what it refuses."""

import json
from functools import partial

import numpy as np
import pytest
from PIL import Image

from gridslam.io.maps import read_map_description, write_map
from support.drawn_maps import draw_two_rooms


@pytest.fixture
def call(call):
    return partial(call, "align")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """A map, an architect's plan of it (PNG of 2 cm, turned), a map of another day, and the map's pose in the plan."""
    folder = tmp_path_factory.mktemp("align")
    write_map(folder / "map.yaml", draw_two_rooms())
    plan = draw_two_rooms(0.6, 0.02, table=None)
    Image.fromarray(np.where(plan.log_odds > 0, 0, 255).astype(np.uint8)[::-1]).save(folder / "plan.png")
    write_map(folder / "later.yaml", draw_two_rooms(-0.3))
    return folder, np.array([*-np.array(plan.origin), 0.6]), len(plan.known)


def test_a_plan_with_a_unit_is_matched_by_its_walls(call, drawn, tmp_path):
    folder, pose, _ = drawn
    status, out, err = call(folder / "map.yaml", folder / "plan.png", "--unit", "0.02", "-o", tmp_path, "--json")
    assert (status, err) == (0, "")
    document = json.loads(out)
    assert document["map_in_plan"] == pytest.approx(pose, abs=0.03)
    assert document["scale"] == pytest.approx(1.0, abs=0.005)
    assert document["walls_in_common"] > 0.6
    description = read_map_description(tmp_path / "map.yaml")
    assert description.yaw_rad == pytest.approx(pose[2], abs=0.005)
    with Image.open(tmp_path / "align.png") as image:
        assert (214, 40, 40) in {colour for _, colour in image.convert("RGB").getcolors(1 << 20)}


def test_a_map_of_another_day_is_a_plan(call, drawn, tmp_path):
    folder, _, _ = drawn
    document = json.loads(call(folder / "map.yaml", folder / "later.yaml", "-o", tmp_path, "--json")[1])
    assert document["map_in_plan"] == pytest.approx([0.0, 0.0, -0.3], abs=0.03)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["plan.png"], "expected a plan with a scale: state --unit"),
        (["later.yaml", "--unit", "2"], "expected no --unit with a map"),
        (["plan.png", "--unit", "0.4"], "of its walls agree with it"),
        (["empty.png", "--unit", "1"], "expected walls, got none"),
    ],
)
def test_what_cannot_be_aligned_is_one_line(call, drawn, tmp_path, arguments, problem):
    folder, _, _ = drawn
    Image.new("L", (40, 50), 255).save(folder / "empty.png")
    given = [folder / word if word.endswith(("png", "yaml")) else word for word in arguments]
    status, out, err = call(folder / "map.yaml", *given, "-o", tmp_path / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert problem in err
    assert not (tmp_path / "out").exists()
