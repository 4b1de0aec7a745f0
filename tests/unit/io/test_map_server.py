"""Maps as map_server reads and writes them."""

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

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


@pytest.mark.parametrize(
    "yaml",
    [
        YAML.replace("[-1.5, 2, 0]", "\n- -1.5\n- 2.0\n- 0.0"),
        "# a comment\n---\n" + YAML.replace("map.pgm", "'map.pgm'") + "unknown_key: 3\n",
        YAML.replace("map.pgm", '"map.pgm"').replace("negate: 0", "negate: false  # comment"),
        YAML.replace("\n", "\r\n"),
        YAML.replace(": ", ":\t").replace("\n", "\t\n"),
        YAML.replace("negate: 0", "negate: no") + "mode: Trinary\n",
        YAML + "bounds: {x: [1, 2]}\n",
    ],
)
def test_ways_to_say_the_same(tmp_path, yaml):
    grid = read_map(write(tmp_path, [[0, 254]], yaml))
    assert states(grid) == [[1, 0]]
    assert grid.origin == (-1.5, 2.0)


@pytest.mark.parametrize(
    ("yaml", "pixels", "remark"),
    [
        (YAML.replace("negate: 0", "negate: 1"), [[254, 254, 205, 0]], "3 cells are occupied and 1 are free: negate"),
        (YAML, [[205, 205]], "no cell is known"),
        (YAML.replace("0.05", "5"), [[254, 0]], "sides of 5 m: the resolution may be in centimetres"),
        (YAML.replace("2, 0]", "2, -nan(ind)]"), [[254, 0]], r"yaw -nan\(ind\) of the origin is taken as 0"),
        (YAML, [[0, 0, 254, 205]], None),
    ],
)
def test_what_is_odd_about_a_map_is_remarked(tmp_path, yaml, pixels, remark):
    remarks = []
    read_map(write(tmp_path, pixels, yaml), on_remark=remarks.append)
    assert len(remarks) == (remark is not None)
    assert remark is None or re.search(remark, remarks[0])


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
        (YAML.replace("map.pgm", "/home/me/gone.pgm"), 1, "image /home/me/gone.pgm is not there, nor gone.pgm beside"),
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


def test_an_empty_grid_is_refused(tmp_path):
    grid = OccupancyGrid(np.zeros((0, 3), np.float32), np.zeros((0, 3), bool), 0.05, (0.0, 0.0))
    with pytest.raises(ArgumentError, match="at least one cell"):
        write_map(tmp_path / "m.yaml", grid)
