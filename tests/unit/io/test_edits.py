"""Edits of a map are read as they were written, refused where they are none, and drawn where they lie."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy import ndimage

from gridslam.errors import InputError
from gridslam.io.edited_maps import apply_edits, cells_of, check_edits, compute_image_digest
from gridslam.io.edits import LAYERS, Edit, Edits, read_edits, write_edits
from gridslam.io.maps import read_map, write_map
from gridslam.types import OccupancyGrid

SQUARE = np.array([[1.0, 1.0], [3.0, 1.0], [3.0, 2.0], [1.0, 2.0]])
LINE = np.array([[0.5, 0.5], [4.5, 2.5]])


def _draw_all():
    """An edit of each layer and geometry."""
    places = {"Point": SQUARE[:1], "LineString": LINE, "Polygon": SQUARE}
    return Edits(
        tuple(
            Edit(
                layer,
                kind,
                places[kind],
                "Küche" if layer == "rooms" else "",
                0.25 if kind == "LineString" else 0.0,
                30.0 if layer == "speed" else 0.0,
            )
            for layer, kinds in LAYERS.items()
            for kind in kinds
        ),
        "map.yaml",
        "ab" * 32,
    )


def _empty(side=0.05, rows=80, columns=120, origin=(0.0, 0.0)):
    return OccupancyGrid(np.full((rows, columns), -4.0, np.float32), np.ones((rows, columns), np.bool_), side, origin)


def _document(geometry, coordinates, **properties):
    feature = {
        "type": "Feature",
        "properties": properties,
        "geometry": {"type": geometry, "coordinates": coordinates},
    }
    return {"type": "FeatureCollection", "features": [feature]}


def test_edits_are_read_as_they_were_written(tmp_path):
    write_edits(tmp_path / "edits.geojson", _draw_all())
    read = read_edits(tmp_path / "edits.geojson")
    assert read.to_text() == _draw_all().to_text()
    assert [edit.layer for edit in read.of("walls", "speed")] == ["walls", "walls", "speed"]
    assert (read.map_name, read.map_sha256) == ("map.yaml", "ab" * 32)
    document = json.loads((tmp_path / "edits.geojson").read_text(encoding="utf-8"))
    for feature in document["features"]:
        if feature["geometry"]["type"] == "Polygon":
            (ring,) = feature["geometry"]["coordinates"]
            assert ring[0] == ring[-1]


RING = [[0, 0], [2, 0], [2, 2], [0, 2], [0, 0]]


@pytest.mark.parametrize(
    ("document", "problem"),
    [
        ([], "expected a JSON object"),
        ({"type": "Feature"}, "expected a FeatureCollection"),
        ({"type": "FeatureCollection", "features": [], "units": "degrees"}, "expected the units 'm', got 'degrees'"),
        ({"type": "FeatureCollection", "features": [], "frame": "utm"}, "expected the frame 'map', got 'utm'"),
        ({"type": "FeatureCollection", "features": [], "schema": "x/2"}, "expected the schema"),
        ({"type": "FeatureCollection", "features": [], "map": "m"}, "expected map: the file of a map"),
        (_document("Polygon", [RING], layer="lava"), "feature 1: expected a layer of walls"),
        (_document("Point", [0, 0], layer="keep_out"), "feature 1: expected a Polygon in the layer keep_out"),
        (_document("Polygon", [RING, RING], layer="keep_out"), "without holes"),
        (_document("Polygon", [RING[:4]], layer="keep_out"), "closed ring"),
        (_document("Polygon", [[[0, 0], [1, 0], [2, 0], [0, 0]]], layer="keep_out"), "with an area"),
        (_document("Polygon", [[[0, 0], [1, 0], ["x", 1], [0, 0]]], layer="erased"), "expected positions [x, y]"),
        (_document("Polygon", [[[0, 0], [1e9, 0], [0, 1e9], [0, 0]]], layer="erased"), "within 1e+06 m"),
        (_document("LineString", [[0, 0]], layer="walls"), "expected 2 to 1000 positions"),
        (_document("LineString", [[1, 1], [1, 1]], layer="walls"), "a line with a length"),
        (_document("LineString", [[0, 0], [1, 1]], layer="walls", width_m=0), "expected width_m from 0.01 to 10"),
        (_document("Point", [0, 0], layer="rooms"), "expected a name of 1 to 100"),
        (_document("Point", [0, 0], layer="rooms", name="a\nb"), "expected a name of 1 to 100"),
        (_document("Polygon", [RING], layer="speed"), "limit_percent from 1 to 100"),
        (_document("Polygon", [RING], layer="speed", limit_percent=0), "limit_percent from 1 to 100"),
        (_document("Polygon", [RING], layer="speed", limit_percent=True), "limit_percent from 1 to 100"),
    ],
)
def test_what_is_no_edit_is_refused_by_its_number(tmp_path, document, problem):
    path = tmp_path / "edits.geojson"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError) as refused:
        read_edits(path)
    assert problem in str(refused.value)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("seed", range(6))
def test_a_polygon_has_the_cells_whose_middles_are_in_it_and_some_on_its_sides(seed):
    rng = np.random.default_rng(seed)
    grid = _empty(origin=(-1.5, 0.7))
    angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
    ring = rng.uniform(0, 4, 2) + rng.uniform(0.3, 3, (9, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    window, inside = cells_of(Edit("keep_out", "Polygon", ring), grid)
    found = np.zeros(grid.shape, np.bool_)
    found[window] = inside
    rows, columns = np.indices(grid.shape)
    x, y = -1.5 + 0.05 * (columns + 0.5), 0.7 + 0.05 * (rows + 0.5)
    expected = np.zeros(grid.shape, np.bool_)
    for (ax, ay), (bx, by) in zip(ring, np.roll(ring, -1, axis=0), strict=True):  # the crossing number of each cell
        expected ^= ((ay > y) != (by > y)) & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    sides = np.linspace(ring, np.roll(ring, -1, axis=0), 500).reshape(-1, 2)
    column, row = np.floor((sides - grid.origin) / 0.05).astype(int).T
    inside = (row >= 0) & (column >= 0) & (row < 80) & (column < 120)
    surely = ndimage.binary_erosion(expected, np.ones((3, 3)), border_value=1)
    assert found[surely].all()
    expected[row[inside], column[inside]] = True
    assert not (found & ~ndimage.binary_dilation(expected, np.ones((3, 3)))).any()
    assert 50 < found.sum() < found.size


@pytest.mark.parametrize("rise_m", [0.0, 0.3, 1.1, 2.0, 3.2])
@pytest.mark.parametrize("width_m", [0.01, 0.3])
def test_a_line_is_as_wide_as_it_is_and_nobody_passes_between_its_cells(width_m, rise_m):
    grid = _empty()
    ends = np.array([[-1.0, 0.5], [7.0, 0.5 + rise_m]])
    found = np.zeros(grid.shape, np.bool_)
    window, inside = cells_of(Edit("no_go", "LineString", ends, "", width_m), grid)
    found[window] = inside
    rows, columns = np.nonzero(found)
    along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
    aside = np.abs((0.05 * (columns + 0.5) - ends[0, 0]) * along[1] - (0.05 * (rows + 0.5) - ends[0, 1]) * along[0])
    assert aside.max() <= max(width_m, 0.15) / 2 + 0.05
    assert found.sum() * 0.05**2 == pytest.approx(max(width_m, 0.12) * 6.0 / along[0], rel=0.35)
    labels, _ = ndimage.label(~found, np.ones((3, 3)))  # robots' planners step to all eight neighbours
    assert labels[0, 0] != labels[-1, 0]


def test_erased_areas_are_free_and_walls_occupied_and_nothing_else_changes():
    grid = _empty()
    grid.known[:, :30] = False
    drawn = Edits((Edit("walls", "LineString", LINE, "", 0.1), Edit("erased", "Polygon", SQUARE)))
    edited = apply_edits(grid, drawn)
    walls, erased = np.zeros(grid.shape, np.bool_), np.zeros(grid.shape, np.bool_)
    for edit, cells in zip(drawn.edits, (walls, erased), strict=True):
        window, inside = cells_of(edit, grid)
        cells[window] = inside
    assert (edited.log_odds[walls] > 2).all()  # also where it was erased: a wall is drawn after
    assert (edited.log_odds[erased & ~walls] < -2).all()
    assert edited.known[walls | erased].all()
    untouched = ~(walls | erased)
    assert (edited.known == grid.known)[untouched].all()
    assert (edited.log_odds == grid.log_odds)[untouched].all()
    assert not (grid.log_odds > 0).any()  # the map itself is as it was


@pytest.fixture
def run(tmp_path):
    """A folder with a map, and edits of it."""
    write_map(tmp_path / "map.yaml", _empty(rows=100, columns=140, origin=(-1.0, -1.0)))
    drawn = Edits((Edit("keep_out", "Polygon", SQUARE),), "map.yaml", compute_image_digest(tmp_path / "map.yaml"))
    write_edits(tmp_path / "edits.geojson", drawn)
    return tmp_path


def test_a_map_that_has_changed_since_is_told_and_places_outside_are_refused(run):
    edits, grid, told = read_edits(run / "edits.geojson"), read_map(run / "map.yaml"), []
    check_edits(edits, "edits.geojson", run / "map.yaml", grid, told.append)
    assert told == []
    write_map(run / "map.yaml", _empty(rows=101, columns=140, origin=(-1.0, -1.0)))
    check_edits(edits, "edits.geojson", run / "map.yaml", grid, told.append)
    assert len(told) == 1
    assert "drawn on another image" in told[0]
    far = Edits((Edit("keep_out", "Polygon", SQUARE + 50),))
    with pytest.raises(InputError, match="feature 1: expected places in"):
        check_edits(far, "edits.geojson", run / "map.yaml", grid, told.append)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the process that is killed is forked")
def test_a_process_that_is_killed_while_it_saves_leaves_one_of_its_files_whole(tmp_path):
    """Two edit files are written in turns, and the process is killed thirty times, at a moment of its own each."""
    path, killed = (
        tmp_path / "edits.geojson",
        """
import os, random, signal, sys, time
import numpy as np
from gridslam.io.edits import Edit, Edits, read_edits, write_edits
path, rng = sys.argv[1], random.Random(0)
files = [Edits((Edit("rooms", "Point", np.array([[1.0, 1.0]]), "a" * 90),) * count) for count in (200, 300)]
write_edits(path, files[0])
for _ in range(30):
    child = os.fork()
    if not child:
        while True:
            for edits in files:
                write_edits(path, edits)
    time.sleep(rng.uniform(0.0, 0.03))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    assert len(read_edits(path).edits) in (200, 300)
write_edits(path, files[1])
""",
    )
    subprocess.run([sys.executable, "-c", killed, str(path)], check=True, timeout=60)
    assert len(read_edits(path).edits) == 300
