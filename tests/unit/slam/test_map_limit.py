"""What the particles' maps may take together."""

from __future__ import annotations

import numpy as np
import pytest

from gridslam.particles import NeverResample
from gridslam.slam import GridFastSlam
from gridslam.slam.grid_fastslam.map_limit import MapLimit, _apportion

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


def test_those_that_stay_go_on_in_the_numbers_that_they_are_worth():
    """Of ten, those of weights 0.5, 0.3 and 0.1 stay, each once; 0.5, 0.3 and 0.1 of 0.9 of the seven others are added.

    These are 3.89, 2.33 and 0.78: 3, 2 and 0 for sure, and the two that are left go to the greatest remainders.
    """
    weights = np.array([0.02, 0.1, 0.01, 0.3, 0.5, *[0.014] * 5])
    parents = _apportion(np.log(weights), np.array([4, 3, 1]))
    assert parents.tolist() == [4] * 5 + [3] * 3 + [1] * 2


def test_maps_within_the_limit_stay_as_they_are(drive, play, contents, free):
    wide = GridFastSlam(when_to_resample=NeverResample(), map_limit=MapLimit(tiles_per_particle=100_000))
    assert contents(play(wide, drive.measurements)[0]) == contents(free[0])


def test_who_looks_on_changes_nothing(drive, play, contents, tight):
    """Snapshots use tiles, too; only the particles' own count."""
    kept, state, rng = [], None, np.random.default_rng(0)
    for odometry, scan in drive.measurements:
        state, _ = TIGHT.step(state, odometry, scan, rng) if state else TIGHT.init(odometry, scan, 5)
        kept.append(state.maps.snapshot())
    assert contents(state) == contents(tight[0])
