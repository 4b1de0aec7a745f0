"""Maps that another thread reads: as they were, whatever their owner does meanwhile."""

import threading
from dataclasses import replace

import numpy as np

from gridslam.grid import Evidence, TileMaps
from gridslam.types import LaserScan, ScanGeometry

ROWS = np.arange(4, dtype=np.int32)


def seen(rng, reach_m=15.0):
    ends = rng.uniform(-reach_m, reach_m, (40, 2))
    beams = LaserScan.from_ranges(0, np.hypot(*ends.T), ScanGeometry(np.zeros(len(ends)))).beams(0.0, np.inf)
    return replace(beams, indices=np.arange(len(ends)), ends=ends)


def drive(maps, rng, updates, reach_m=15.0):
    for _ in range(updates):
        maps.update(ROWS, rng.uniform(-20, 20, (4, 3)), seen(rng, reach_m))
        maps.select(rng.integers(0, 4, 4))


def make_maps():
    maps = TileMaps(4, resolution_m=0.1, reach_cells=4.0, evidence=Evidence(2.0, -0.4, -9.0, 9.0, 1.0))
    drive(maps, np.random.default_rng(0), 4)
    return maps


def dump(maps):
    return {name: values.tobytes() for name, values in maps.to_arrays().items()}


def test_copied_maps_stay_as_they_were_while_their_owner_grows_and_compacts():
    maps, loose = make_maps(), make_maps()
    before = dump(maps)
    copied = maps.copy()
    for own in (maps, loose):
        drive(own, np.random.default_rng(1), 6, reach_m=60.0)  # several times as many tiles
    assert maps.nbytes > 2 * copied.nbytes
    assert dump(copied) == before
    assert dump(maps) == dump(loose)  # a copy changes nothing
    maps.compact()
    assert dump(copied) == before
    assert dump(maps) == dump(loose)


def test_maps_are_read_while_they_are_written():
    """A reader of memory that moved would read other bytes, or end the process."""
    maps = make_maps()
    problems = []

    def read(copied, expected):
        problems.extend("changed" for _ in range(5) if dump(copied) != expected)

    readers = []
    for seed in range(12):
        drive(maps, np.random.default_rng(seed), 1, reach_m=30.0 + 5 * seed)
        readers.append(threading.Thread(target=read, args=(maps.copy(), dump(maps))))
        readers[-1].start()
    for reader in readers:
        reader.join()
    assert problems == []
