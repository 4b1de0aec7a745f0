"""Masks of nav2's filters have the values that its table of values asks for."""

import numpy as np
from PIL import Image

from gridslam.io.edits import Edit, Edits
from gridslam.io.maps import occupancy_percent, read_map_description, read_map_image
from gridslam.io.yaml import parse_yaml
from gridslam.plan.masks import Mask, make_keepout_mask, make_speed_mask, write_mask
from gridslam.types import OccupancyGrid

GRID = OccupancyGrid(np.full((20, 40), -4.0, np.float32), np.ones((20, 40), np.bool_), 0.1, (-1.0, 2.0))


def _box(x, y, x2, y2):
    return np.array([[x, y], [x2, y], [x2, y2], [x, y2]], float)


def _speed(x, x2, percent):
    return Edit("speed", "Polygon", _box(x, 2.0, x2, 4.0), limit_percent=percent)


def _values_of_map_server(yaml_path):
    """What nav2's map_server publishes, by its source (map_io.cpp, loadMapFromFile) and another reader of images."""
    fields = parse_yaml(yaml_path.read_text())
    shade = np.asarray(Image.open(yaml_path.parent / fields["image"]), float)[::-1] / 255
    occupied = 1 - shade if not fields["negate"] else shade
    low, high = fields["free_thresh"], fields["occupied_thresh"]
    between = np.rint((occupied - low) / (high - low) * 100.0)
    return np.where(occupied > high, 100, np.where(occupied < low, 0, between))


def test_map_server_reads_every_value_as_it_is(tmp_path):
    values = np.resize(np.arange(101, dtype=np.int8), GRID.shape)
    write_mask(tmp_path / "m.yaml", Mask(values, 0), GRID)
    assert (_values_of_map_server(tmp_path / "m.yaml") == values).all()
    description = read_map_description(tmp_path / "m.yaml")
    assert (occupancy_percent(read_map_image(tmp_path / "m.pgm"), description) == values).all()
    assert (description.origin, description.resolution_m, description.mode) == ((-1.0, 2.0), 0.1, "scale")


def test_robots_are_kept_out_of_polygons_and_lines():
    zone = Edit("keep_out", "Polygon", _box(0.0, 2.0, 1.0, 3.0))
    line = Edit("no_go", "LineString", np.array([[2.05, 2.0], [2.05, 4.0]]), width_m=0.1)
    mask = make_keepout_mask(GRID, Edits((zone, line)))
    assert mask.kind == 0
    assert set(np.unique(mask.values)) == {0, 100}
    assert (mask.values[:10, 10:20] == 100).all()
    assert (mask.values[:, 30] == 100).all()
    assert (mask.values == 100).sum() <= 12 * 11 + 2 * 20


def test_nobody_passes_between_the_cells_of_an_oblique_line():
    line = Edit("no_go", "LineString", np.array([[-0.9, 2.1], [2.9, 3.8]]), width_m=0.1)
    mask = make_keepout_mask(GRID, Edits((line,)))
    for column in range(3, 37):
        rows = np.flatnonzero(mask.values[:, column])
        beside = np.flatnonzero(mask.values[:, column + 1])
        assert set(rows) & set(beside), "4-connected"


def test_the_lowest_speed_holds_where_zones_overlap():
    mask = make_speed_mask(GRID, Edits((_speed(0, 1, 20.0), _speed(-1, 2, 60.0))))
    assert mask.kind == 1
    assert (mask.values[10, [3, 15, 25, 35]] == [60, 20, 60, 0]).all()
