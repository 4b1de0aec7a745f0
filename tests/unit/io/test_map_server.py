"""Maps as map_server reads and writes them."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from gridslam.errors import ArgumentError, InputError
from gridslam.io.maps import read_map, write_map
from gridslam.types import OccupancyGrid

YAML = "image: map.pgm\nresolution: 0.05\norigin: [-1.5, 2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def write(folder, pixels, yaml=YAML):
    pixels = np.array(pixels, dtype=np.uint8)
    header = f"P5\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode()
    (folder / "map.pgm").write_bytes(header + pixels.tobytes())
    (folder / "map.yaml").write_text(yaml)
    return folder / "map.yaml"


def states(grid):
    """-1 unknown, 0 free, 1 occupied."""
    return np.where(grid.known, np.where(grid.log_odds > 0, 1, 0), -1).tolist()


def test_the_pixels_of_each_state(tmp_path):
    # Bottom row: occupied, free, never seen; top row: probabilities between the thresholds 0.196 and 0.65.
    log_odds = np.array([[3, -3, 3], [0.6, 0, -1.4]], dtype=np.float32)
    known = np.array([[True, True, False], [True, True, True]])
    write_map(tmp_path / "m.yaml", OccupancyGrid(log_odds, known, 0.05, (-1.0, 2.5)))
    assert (tmp_path / "m.pgm").read_bytes() == b"P5\n3 2\n255\n" + bytes([205, 205, 205, 0, 254, 205])
    assert (tmp_path / "m.yaml").read_text() == (
        "image: m.pgm\nmode: trinary\nresolution: 0.05\norigin: [-1.0, 2.5, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )


def test_pillow_agrees_on_the_image(tmp_path):
    grid = OccupancyGrid(np.full((2, 5), 4, np.float32), np.ones((2, 5), bool), 0.1, (0.0, 0.0))
    write_map(tmp_path / "m.yaml", grid)
    with Image.open(tmp_path / "m.pgm") as image:
        assert (image.size, image.mode, image.getpixel((4, 1))) == ((5, 2), "L", 0)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=50)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(1e-3, 10),
    st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
    st.text(min_size=1, max_size=8).filter(lambda name: name.isprintable() and not set(name) & set("/\\")),
)
def test_round_trip(tmp_path, seed, resolution, origin, name):
    cells = np.random.default_rng(seed).integers(-1, 2, (3, 4))
    grid = OccupancyGrid(np.float32(9) * (2 * cells - 1), cells >= 0, resolution, origin)
    write_map(tmp_path / f"{name}.yaml", grid)
    back = read_map(tmp_path / f"{name}.yaml")
    assert states(back) == cells.tolist()
    assert (back.resolution_m, back.origin) == (resolution, origin)
    assert back.log_odds.dtype == np.float32


def test_lower_left_is_cell_zero(tmp_path):
    grid = read_map(write(tmp_path, [[254, 254], [0, 205]]))
    assert states(grid) == [[1, -1], [0, 0]]
    assert grid.origin == (-1.5, 2.0)


def test_205_is_unknown_even_where_the_threshold_calls_it_free(tmp_path):
    yaml = YAML.replace("0.196", "0.25")
    assert states(read_map(write(tmp_path, [[205, 206, 204, 254]], yaml))) == [[-1, 0, 0, 0]]


def test_negate(tmp_path):
    assert states(read_map(write(tmp_path, [[255, 0, 128]], YAML.replace("negate: 0", "negate: 1")))) == [[1, 0, -1]]


def test_scale_spans_probability_linearly(tmp_path):
    yaml = YAML.replace("0.196", "0.2").replace("0.65", "0.8") + "mode: scale\n"
    grid = read_map(write(tmp_path, [[0, 255, 255 - 51, 127, 128]], yaml))  # darkness 1, 0, 0.2, 128/255, 127/255
    expected = 0.01 + 0.98 * np.array([1, 0, 0, 0.5, 0.5])  # in whole percent, as a ROS OccupancyGrid has it
    np.testing.assert_allclose(grid.probability[0], expected, atol=1e-6)
    assert grid.known.all()


def test_raw_is_percent(tmp_path):
    grid = read_map(write(tmp_path, [[0, 100, 50, 101, 255]], YAML + "mode: raw\n"))
    assert grid.known.tolist() == [[True, True, True, False, False]]
    np.testing.assert_allclose(grid.probability[0, :3], [0.01, 0.99, 0.5], atol=1e-6)


def test_transparent_pixels_are_unknown(tmp_path):
    yaml = write(tmp_path, [[0]], YAML.replace("map.pgm", "map.png"))
    Image.fromarray(np.array([[[0, 255], [0, 0], [254, 255]]], dtype=np.uint8), "LA").save(tmp_path / "map.png")
    assert states(read_map(yaml)) == [[1, -1, 0]]


@pytest.mark.parametrize(
    "yaml",
    [
        YAML.replace("[-1.5, 2, 0]", "\n- -1.5\n- 2.0\n- 0.0"),
        "# a comment\n---\n" + YAML.replace("map.pgm", "'map.pgm'") + "unknown_key: 3\n",
        YAML.replace("map.pgm", '"map.pgm"').replace("negate: 0", "negate: false  # comment"),
        YAML.replace("\n", "\r\n"),
    ],
)
def test_ways_to_say_the_same(tmp_path, yaml):
    grid = read_map(write(tmp_path, [[0, 254]], yaml))
    assert states(grid) == [[1, 0]]
    assert grid.origin == (-1.5, 2.0)


@pytest.mark.parametrize(
    ("yaml", "line", "problem"),
    [
        (YAML.replace("resolution: 0.05\n", ""), None, "resolution"),
        (YAML.replace("0.05", "0"), 2, "resolution from 0.001 to 10 m"),
        (YAML.replace("0.05", "1e-9"), 2, "resolution from 0.001 to 10 m"),
        (YAML.replace("0.05", "50"), 2, "resolution from 0.001 to 10 m"),
        (YAML.replace("0.05", "wide"), 2, "number for resolution"),
        (YAML.replace("[-1.5, 2, 0]", "[-1.5, 2]"), 3, "origin"),
        (YAML.replace("2, 0]", "2, inf]"), 3, "number for origin"),
        (YAML.replace("2, 0]", "2, -90.0]"), 3, "yaw of the origin in rad, got -90: it looks like degrees"),
        (YAML.replace("2, 0]", "nan, 0]"), 3, "number for origin"),
        (YAML.replace("negate: 0", "negate: maybe"), 4, "negate"),
        (YAML.replace("0.196", "0.7"), 6, "free_thresh"),
        (YAML + "mode: grey\n", 7, "mode"),
        (YAML + "nonsense\n", 7, "key: value"),
        (YAML + "negate: 0\n", 7, "once"),
        ("", None, "empty"),
    ],
)
def test_bad_yaml(tmp_path, yaml, line, problem):
    with pytest.raises(InputError, match=problem) as caught:
        read_map(write(tmp_path, [[0]], yaml))
    assert caught.value.line == line


@pytest.mark.parametrize("name", ["/home/user/map.pgm", "~/map.pgm", r"C:\Users\me\map.pgm", "../maps/map.pgm"])
def test_an_image_that_was_moved_is_found_beside_its_yaml(tmp_path, name):
    told = []
    path = write(tmp_path, [[0, 254]], YAML.replace("map.pgm", name))
    assert states(read_map(path, on_remark=told.append)) == [[1, 0]]
    assert told == [f"the image {name} is not there: map.pgm beside the YAML file is read"]
    (tmp_path / "map.pgm").rename(tmp_path / "other.pgm")
    with pytest.raises(InputError, match="no such file"):
        read_map(path)


def test_an_image_that_is_where_it_is_named_is_read(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    path = write(tmp_path, [[0, 254]], YAML.replace("map.pgm", str(tmp_path / "elsewhere" / "map.pgm")))
    write(tmp_path / "elsewhere", [[254, 254]])
    told = []
    assert states(read_map(path, on_remark=told.append)) == [[0, 0]]
    assert told == []


@pytest.mark.parametrize("yaw", ["0.0001", "-0.001", ".nan", ".NaN", "nan", "-nan", "null"])
def test_a_yaw_that_turns_nothing_is_taken_as_0(tmp_path, yaw):
    told = []
    path = write(tmp_path, [[0, 254]], YAML.replace("2, 0]", f"2, {yaw}]"))
    assert states(read_map(path, on_remark=told.append)) == [[1, 0]]
    assert told == [f"the yaw {yaw} of the origin is taken as 0"]


def test_bad_images(tmp_path):
    yaml = write(tmp_path, [[0, 0]])
    (tmp_path / "map.pgm").write_bytes(b"P5\n200 200\n255\n123")
    with pytest.raises(InputError, match=r"map\.pgm"):
        read_map(yaml)
    (tmp_path / "map.pgm").write_bytes(b"no image")
    with pytest.raises(InputError, match="expected an image"):
        read_map(yaml)
    (tmp_path / "map.pgm").unlink()
    with pytest.raises(InputError, match="no such file"):
        read_map(yaml)


def test_an_empty_grid_is_refused(tmp_path):
    grid = OccupancyGrid(np.zeros((0, 3), np.float32), np.zeros((0, 3), bool), 0.05, (0.0, 0.0))
    with pytest.raises(ArgumentError, match="at least one cell"):
        write_map(tmp_path / "m.yaml", grid)


@pytest.mark.parametrize("name", ["meeting", "mac_1st_floor_final"])
def test_real_maps_have_all_three_states(data_dir, name):
    path = data_dir / "maps" / f"{name}.yaml"
    grid = read_map(path)
    with Image.open(path.with_suffix(".pgm")) as image:
        assert grid.log_odds.shape == image.size[::-1]
        pixels = np.asarray(image)[::-1]
    assert not grid.known[pixels == 205].any()
    assert (grid.log_odds[pixels == 0] > 0).all()
    assert (grid.log_odds[pixels == 254] < 0).all()
    assert grid.known.any()
