"""The files of a plan are what their formats ask for, and have its measures."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest

from gridslam.plan import make_plan
from gridslam.plan.exports import write_geojson, write_svg
from support.drawn_maps import draw_two_rooms


@pytest.fixture(scope="module")
def plan():
    return make_plan(draw_two_rooms())


@pytest.mark.parametrize(("scale", "angle_deg"), [(50, 0.0), (100, 0.0), (100, 17.0)])
def test_the_svg_is_to_scale_and_its_walls_run_along_the_sheet(tmp_path, scale, angle_deg):
    write_svg(tmp_path / "plan.svg", make_plan(draw_two_rooms(np.deg2rad(angle_deg))), "<two> & rooms", scale)
    root = ElementTree.parse(tmp_path / "plan.svg").getroot()
    space = "{http://www.w3.org/2000/svg}"
    assert root.find(f"{space}title").text == f"<two> & rooms, 1:{scale}"
    width = float(root.get("width").removesuffix("mm"))
    assert root.get("viewBox").split()[2] == f"{width:.2f}"  # a unit is a millimetre
    assert {"rooms", "walls", "faces", "doors", "furniture", "text"} <= {part.get("class") for part in root}
    room = next(part for part in root if part.get("class") == "rooms")
    corners = np.array([pair.split(",") for pair in room.get("points").split()], float)
    assert np.ptp(corners, axis=0) == pytest.approx([6000 / scale, 4000 / scale], abs=150 / scale)
    assert (corners > 0).all()


def _signed_area(ring):
    x, y = np.array(ring[:-1]).T
    return 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)


def test_the_geojson_keeps_to_rfc_7946(plan, tmp_path):
    write_geojson(tmp_path / "plan.geojson", plan, "two rooms")
    document = json.loads((tmp_path / "plan.geojson").read_text(encoding="utf-8"))
    assert document["type"] == "FeatureCollection"
    assert "crs" not in document  # section 4: no longer there
    layers = set()
    for feature in document["features"]:
        assert feature.keys() == {"type", "properties", "geometry"}
        layers.add(feature["properties"]["layer"])
        geometry = feature["geometry"]
        rings = geometry["coordinates"] if geometry["type"] == "Polygon" else [geometry["coordinates"]]
        for number, ring in enumerate(rings):
            assert np.isfinite(ring).all()
            if geometry["type"] == "Polygon":
                assert len(ring) >= 4
                assert ring[0] == ring[-1]
                assert (_signed_area(ring) > 0) == (number == 0)  # section 3.1.6: the right-hand rule
    assert {"walls", "doors", "rooms", "furniture"} <= layers
