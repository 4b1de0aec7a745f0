"""Log-odds in a byte, where one holds all that a cell can, are those that two bytes hold."""

import numpy as np
import pytest

from gridslam.grid.arena import TileArena
from gridslam.grid.cells import Evidence
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import UNKNOWN, backend, reference
from gridslam.models.inverse_sensor import InverseSensorModel
from gridslam.types import StoredScan

MODEL = InverseSensorModel()
DEFAULT = (MODEL.log_odds_hit, MODEL.log_odds_miss, MODEL.log_odds_min, MODEL.log_odds_max, MODEL.log_odds_occupied)
FULL = (1.27, -0.01, -1.27, 1.27, -1.27)
"""All that a byte holds is met."""
ROWS = np.arange(2, dtype=np.int32)
BACKENDS = pytest.mark.parametrize("kernels", [backend, reference], ids=["backend", "twins"])


def make(values, wide=False):
    maps = TileMaps(2, resolution_m=0.1, reach_cells=4.0, evidence=Evidence(*values))
    if wide:
        maps._arena = TileArena()
    return maps


def random_scan(rng, beams=300):
    """Around the robot, the nearest ends in the same few cells, so that cells are passed and hit many times."""
    bearing, reach = rng.uniform(-np.pi, np.pi, beams), rng.choice([0.3, 2.0, 6.0], beams)
    return StoredScan(reach[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1), np.zeros(2))


def draw(maps, seed, scans=6):
    rng = np.random.default_rng(seed)
    for count in range(scans):
        maps.update(ROWS, rng.normal(scale=0.3, size=(2, 3)), random_scan(rng, 30 if count % 2 else 300))


def contents(maps):
    return [array.tobytes() for array in maps.to_arrays().values()]


@BACKENDS
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("values", [DEFAULT, FULL, (0.2, -0.1, -0.3, 0.5, 0.1)])
def test_maps_are_the_same_in_a_byte_and_in_two(values, seed, kernels, monkeypatch):
    monkeypatch.setattr("gridslam.grid.tiles.backend", kernels)
    ours, wide = make(values), make(values, wide=True)
    for maps in ours, wide:
        draw(maps, seed)
    assert (ours._arena.log_odds.dtype, wide._arena.log_odds.dtype) == (np.int8, np.int16)
    assert contents(ours) == contents(wide)
    points = np.random.default_rng(seed).uniform(-8, 8, (2000, 2))
    for row in range(2):
        assert ours.occupancy(row).log_odds.tobytes() == wide.occupancy(row).log_odds.tobytes()
        known = ours.is_known(row, points)
        assert 0 < known.mean() < 1
        np.testing.assert_array_equal(known, wide.is_known(row, points))


@pytest.mark.parametrize("values", [DEFAULT, FULL])
def test_what_is_written_of_maps_does_not_depend_on_how_they_are_stored(values):
    """Steps of 0.01 nats in 16 bits; read again, they go on alike."""
    maps = make(values)
    draw(maps, 1)
    arrays = maps.to_arrays()
    assert arrays["log_odds"].dtype == np.int16
    cells = arrays["log_odds"][arrays["log_odds"] != UNKNOWN]
    assert cells.min() == maps.evidence.steps[2]
    assert cells.max() > maps.evidence.occupied_above
    again = TileMaps.from_arrays(arrays, resolution_m=0.1, reach_cells=4.0, evidence=maps.evidence)
    assert again._arena.log_odds.dtype == np.int8
    for both in maps, again:
        draw(both, 2)
    assert contents(maps) == contents(again)
