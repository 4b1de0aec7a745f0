"""What loop closure remembers goes on to the same bytes from a snapshot and from arrays, cut anywhere."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.grid.tiles import TileMaps
from gridslam.serialization import from_arrays, to_arrays
from gridslam.slam.loop_closure.state import Correction, LoopClosureState
from gridslam.slam.loop_closure.submaps import ROW
from support import hall


@pytest.fixture(scope="module")
def seen():
    return hall.key_scans(hall.drive(1))


@pytest.fixture(scope="module")
def poses(seen):
    return hall.tracked(seen.truth, 0.002, 1.01)


def contents(closure_state):
    return {name: (array.dtype, array.shape, array.tobytes()) for name, array in to_arrays(closure_state).items()}


def restored(arrays, threads=1):
    restore = {TileMaps: partial(hall.MAPPER.restore, threads=threads)}
    return from_arrays(LoopClosureState, arrays, restore)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_pending_correction_is_kept_and_drawn_on_apart(seen, poses, threads):
    closure_state = LoopClosureState()
    hall.remember(closure_state, seen, poses, until=40)
    maps = hall.MAPPER.empty(1)
    closure_state.correction = Correction(seen.truth[:40], maps, inserted=10)
    for key in range(10):
        maps.update(ROW, seen.truth[key][None], closure_state.scans.key(key))
    before = contents(closure_state)
    kept, read = closure_state.snapshot(), restored(to_arrays(closure_state), threads)
    for twin in (closure_state, kept, read):
        assert contents(twin) == before
        twin.correction.maps.update(ROW, seen.truth[10][None], twin.scans.key(10))
        twin.correction.poses = seen.truth[:41]
        twin.correction.inserted += 1
        after = contents(twin)
        assert after != before
    assert contents(closure_state) == contents(kept) == after


@pytest.mark.parametrize("name", ["search.compared", "online_poses", "rejected", "graph.covariances", "graph.tracked"])
def test_a_missing_array_is_told(seen, poses, name):
    closure_state = LoopClosureState()
    hall.remember(closure_state, seen, poses, until=5)
    arrays = to_arrays(closure_state)
    assert isinstance(arrays.pop(name), np.ndarray)
    with pytest.raises(ArgumentError, match=f"an array named {name}"):
        restored(arrays)


def test_a_missing_array_of_the_archive_is_told(seen, poses):
    closure_state = LoopClosureState()
    hall.remember(closure_state, seen, poses, until=5)
    arrays = to_arrays(closure_state)
    del arrays["scans.ends"]
    with pytest.raises(ArgumentError, match="expected an array named ends"):
        restored(arrays)
