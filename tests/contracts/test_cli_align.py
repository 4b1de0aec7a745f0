"""What `gridslam align` writes and reports, from pairs and from walls, and what it refuses."""

import json
from functools import partial

import ezdxf
import numpy as np
import pytest
from PIL import Image

from gridslam.geometry import se2
from gridslam.io.maps import read_map_description, write_map
from support.drawn_maps import draw_two_rooms

CORNERS = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 4.0]])


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


def _pairs(pose, height, unit_m, noise=0.0):
    """Options of pairs: corners of the map, and where they are seen in the image."""
    there = se2.transform_points(pose, CORNERS) / unit_m + noise
    for (x, y), (u, v) in zip(CORNERS, there, strict=True):
        yield from ("--pair", f"{x},{y}={u},{height - v}")


def test_a_plan_with_a_unit_is_matched_by_its_walls(call, drawn, tmp_path):
    folder, pose, _ = drawn
    status, out, err = call(folder / "map.yaml", folder / "plan.png", "--unit", "0.02", "-o", tmp_path, "--json")
    assert (status, err) == (0, "")
    document = json.loads(out)
    assert document["map_in_plan"] == pytest.approx(pose, abs=0.03)
    assert document["scale"] == pytest.approx(1.0, abs=0.005)
    assert document["walls_in_common"] > 0.6
    assert document["pairs_left_m"] == []
    description = read_map_description(tmp_path / "map.yaml")
    assert description.yaw_rad == pytest.approx(pose[2], abs=0.005)
    with Image.open(tmp_path / "align.png") as image:
        assert (214, 40, 40) in {colour for _, colour in image.convert("RGB").getcolors(1 << 20)}


def test_pairs_give_the_unit_and_their_residuals(call, drawn, tmp_path):
    folder, pose, height = drawn
    pairs = [*_pairs(pose, height, 0.02, np.array([[5.0, 0.0], [0.0, -5.0], [-4.0, 3.0]]))]
    document = json.loads(call(folder / "map.yaml", folder / "plan.png", *pairs, "-o", tmp_path, "--json")[1])
    assert document["scale"] / document["unit_m"] == pytest.approx(50.0, rel=0.005)  # pixels a metre
    assert all(0 < left < 0.12 for left in document["pairs_left_m"])
    alone = json.loads(
        call(folder / "map.yaml", folder / "plan.png", *pairs, "--by-pairs", "-o", tmp_path, "--json")[1]
    )
    assert alone["walls_in_common"] is None
    assert abs(alone["map_in_plan"][2] - pose[2]) > abs(document["map_in_plan"][2] - pose[2])


def test_a_map_of_another_day_is_a_plan(call, drawn, tmp_path):
    folder, _, _ = drawn
    document = json.loads(call(folder / "map.yaml", folder / "later.yaml", "-o", tmp_path, "--json")[1])
    assert document["map_in_plan"] == pytest.approx([0.0, 0.0, -0.3], abs=0.03)


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["plan.png"], "expected a plan with a scale: state --unit"),
        (["plan.png", "--pair", "0,0=1,1"], "expected two to six pairs"),
        (["plan.png", "--pair", "0,0=1,1", "--pair", "0,0=2,2"], "expected places that are apart"),
        (["plan.png", "--pair", "0,0", "--pair", "1,1=2,2"], "expected X,Y=U,V"),
        (["plan.png", "--pair", "0,0=1,1,2,2,3,3"], "expected X,Y=U,V"),
        (["later.yaml", "--unit", "2"], "expected no --unit with a map"),
        (["plan.png", "--pair", "nan,0=1,1", "--pair", "1,1=2,2"], "finite numbers"),
        (["plan.png", "--by-pairs"], "expected two to six --pair"),
        (["plan.png", "--unit", "0.4"], "of its walls agree with it"),
        (["empty.dxf", "--unit", "1"], "expected a plan with lines"),
    ],
)
def test_what_cannot_be_aligned_is_one_line(call, drawn, tmp_path, arguments, problem):
    folder, _, _ = drawn
    ezdxf.new().saveas(folder / "empty.dxf")
    given = [folder / word if word.endswith(("png", "dxf", "yaml")) else word for word in arguments]
    status, out, err = call(folder / "map.yaml", *given, "-o", tmp_path / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert problem in err
    assert not (tmp_path / "out").exists()
