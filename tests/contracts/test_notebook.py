"""What a session in Python or a notebook shows of results: one line each, a picture of each map, and tables."""

import io

import numpy as np
import pytest
from PIL import Image

import gridslam


@pytest.fixture(scope="module")
def mapped(log):
    return gridslam.map_log(log, particles=2)


@pytest.fixture(scope="module")
def results(log, mapped, park, tmp_path_factory):
    folder = tmp_path_factory.mktemp("landmarks")
    landmarks = gridslam.map_landmarks(park[0], "ekf")
    landmarks.save(folder / "out")
    return {
        "MapResult": mapped,
        "LocalizationResult": gridslam.localize(log, mapped.map, pose=np.zeros(3)),
        "GridResult": gridslam.map_with_poses(log, mapped.trajectory),
        "LandmarkResult": landmarks,
        "LandmarkLocalizationResult": gridslam.localize_by_landmarks(park[0], folder / "out" / "landmarks.csv"),
    }


def empty_grid(shape=(0, 0)):
    return gridslam.OccupancyGrid(np.zeros(shape, np.float32), np.zeros(shape, bool), 0.05, (0.0, 0.0))


def test_a_grid_is_shown_as_map_files_have_it(mapped):
    grid = mapped.map
    pixels = np.asarray(Image.open(io.BytesIO(grid._repr_png_())))
    assert pixels.shape == grid.known.shape
    assert ((pixels == 205) == ~grid.known[::-1]).all()
    assert ((pixels < 100) <= (grid.log_odds > 0)[::-1]).all()
    assert (pixels[(grid.log_odds > 2)[::-1] & grid.known[::-1]] < 50).all()
    large = empty_grid((5, 3001))
    large.known[2, 1500] = True
    large.log_odds[2, 1500] = 5.0
    shrunk = np.asarray(Image.open(io.BytesIO(large._repr_png_())))
    assert max(shrunk.shape) <= 1000
    assert (shrunk < 50).any()  # a wall of one cell is still there
    assert empty_grid()._repr_png_() is None
