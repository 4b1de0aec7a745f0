"""What the particles' maps may take together."""

import numpy as np
import pytest

from gridslam.particles import NeverResample
from gridslam.slam import GridFastSlam
from gridslam.slam.grid_fastslam.map_limit import MapLimit

FREE = GridFastSlam(when_to_resample=NeverResample(), map_limit=MapLimit(tiles_per_particle=10_000))
TIGHT = GridFastSlam(when_to_resample=NeverResample(), map_limit=MapLimit(tiles_per_particle=20))


def differing(state):
    """Tiles of all maps that are not the best particle's."""
    every = np.arange(len(state.poses))
    return state.maps.tiles_of(every) - state.maps.tiles_of(np.array([state.best]))


@pytest.fixture(scope="module")
def free(drive, play):
    return play(FREE, drive.measurements)


@pytest.fixture(scope="module")
def tight(drive, play):
    return play(TIGHT, drive.measurements)


def test_maps_that_differ_too_much_become_alike_again(free, tight):
    """One scan of this hall touches some 40 tiles: those that differ since the last count are not bounded."""
    assert differing(tight[0]) < 0.6 * differing(free[0])
    gave_way = [report for report in tight[1] if report.parents is not None]
    assert gave_way
    assert all(report.parents is None for report in free[1])


def test_those_of_most_weight_stay(drive, play):
    state, _ = play(FREE, drive.measurements)
    while state.ancestry.steps % 16:  # tiles are counted at each sixteenth key scan only
        state.ancestry.extend(state.poses)
    count, weights = len(state.poses), state.log_weights
    parents = MapLimit(tiles_per_particle=differing(state) // count - 1)(state)
    stay = np.unique(parents)
    assert len(parents) == count
    assert len(stay) < count
    assert weights[stay].min() >= np.delete(weights, stay).max()
