"""The kernels with what no robot sends: far and odd poses, beams without end or number, none, and very many.

Nothing crashes, hangs or writes beside its arrays; the last is what `tests/asan.sh` sees.
"""

import contextlib
import math
from dataclasses import replace

import numpy as np
import pytest

from gridslam.errors import ArgumentError
from gridslam.grid import Evidence, TileMaps
from gridslam.localization.known_map import FieldTable
from gridslam.matching.branch_and_bound import BranchAndBound, Pyramid
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.types import LaserScan, ScanGeometry

ROWS = 3
ODD = (0.0, -0.0, 5e-324, 1e-9, 1e3, 1e5, 1e7, 5.4e7, 1e9, 1e15, 1e300, math.inf, math.nan)
COUNTS = (0, 1, 2, 7, 60, 255, 256, 700)


def some_numbers(rng, shape, scale):
    """Numbers of that scale, a few of them odd."""
    numbers = rng.normal(scale=scale, size=shape)
    odd = rng.random(shape) < rng.choice([0.0, 0.02, 0.3])
    numbers[odd] = rng.choice(ODD, np.count_nonzero(odd)) * rng.choice([-1, 1], np.count_nonzero(odd))
    return numbers


def some_beams(rng, count):
    ends = some_numbers(rng, (count, 2), rng.choice([0.1, 5.0, 100.0]))
    scan = LaserScan.from_ranges(0, np.ones(count), ScanGeometry(np.zeros(count)))
    origin = some_numbers(rng, 2, 0.3)
    return replace(scan.beams(0.0, np.inf), indices=np.arange(count), ends=ends, origin=origin)


def new_maps(rng):
    limits = [(2.4, -0.4, -16.0, 32.0, 2.0), (20.0, -20.0, -150.0, 150.0, 149.0), (0.01, -0.01, -0.02, 0.02, -0.01)]
    return TileMaps(
        ROWS,
        resolution_m=float(rng.choice([0.01, 0.05, 1.0])),
        reach_cells=float(rng.choice([1.0, 3.5, 15.5])),
        evidence=Evidence(*limits[rng.integers(3)]),
        threads=int(rng.integers(1, 3)),
        most_tiles=40_000,
    )


def look(maps, rng):
    """Read the maps in every way."""
    rows = rng.integers(0, ROWS, 4).astype(np.int32)
    poses = some_numbers(rng, (4, 3), 3.0)
    beams = some_beams(rng, int(rng.choice(COUNTS)))
    maps.distances(rows, poses, beams.ends)
    maps.is_known(0, poses[:, :2])
    directions = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    maps.cast_rays(rows, poses, beams.origin, directions, float(rng.choice([0.0, 1.0, 30.0])))
    priors = np.abs(some_numbers(rng, (4, 3, 3), 1.0))
    _, _, *settings = GaussNewton()._settings(maps)
    maps.match(rows, poses, priors, beams.ends, 10, 0, *settings)  # however few beams there are
    thin_m = float(rng.choice([0.0, 0.1, 1e-300]))
    maps.match_pose(0, tuple(poses[0]), (1.0, 0.0, 0.0, 1.0, 0.0, 1.0), beams.ends, thin_m, 10, 0, *settings)
    field, _ = maps.field(0, most_cells=512)
    table = FieldTable.of(np.pad(field.astype(np.float32), 1), some_numbers(rng, 2, 1.0), maps.resolution_m)
    table.sums(poses, beams.ends, maps.threads)
    few = replace(beams, ends=np.nan_to_num(beams.ends, posinf=50.0, neginf=-50.0).clip(-50, 50))
    with contextlib.suppress(ArgumentError):
        search = BranchAndBound(window_m=1.0, window_rad=0.2, min_score=0.2)
        search.search(Pyramid.of(maps, 0, most_cells=512), poses[0], None, few.ends)


@pytest.mark.parametrize("seed", range(15))
def test_odd_scans_end_no_process(seed):
    rng = np.random.default_rng(seed)
    maps = new_maps(rng)
    with np.errstate(all="ignore"):
        for _ in range(8):
            rows = rng.permutation(ROWS)[: rng.integers(1, ROWS + 1)].astype(np.int32)
            beams = some_beams(rng, int(rng.choice(COUNTS)))
            before = maps.to_arrays()["log_odds"]
            try:
                maps.update(rows, some_numbers(rng, (len(rows), 3), 2.0), beams)
            except ArgumentError:
                np.testing.assert_array_equal(maps.to_arrays()["log_odds"], before)
            look(maps, rng)
            match rng.integers(6):
                case 0:
                    maps.select(rng.integers(0, ROWS, ROWS))
                case 1:
                    maps.clear(int(rng.integers(ROWS)))
                case 2:
                    maps = maps.snapshot()
                case 3:
                    maps.compact()


@pytest.mark.parametrize("count", [32_767, 32_768, 65_535, 65_536, 70_000])
def test_very_many_beams(count):
    rng = np.random.default_rng(count)
    maps = new_maps(rng)
    ends = rng.normal(scale=3.0, size=(count, 2))
    ends[: count // 2] = ends[0]
    beams = replace(some_beams(rng, count), ends=ends, origin=np.zeros(2))
    maps.update(np.arange(ROWS, dtype=np.int32), np.zeros((ROWS, 3)), beams)
    look(maps, rng)


def test_beams_of_every_length_up_to_the_longest():
    rng = np.random.default_rng(5)
    maps = TileMaps(1, resolution_m=0.05, reach_cells=3.5, evidence=Evidence(2.4, -0.4, -16.0, 32.0, 2.0))
    ends = np.geomspace(0.01, 1049, 200)[:, None] * np.column_stack([np.cos(np.arange(200)), np.sin(np.arange(200))])
    beams = replace(some_beams(rng, 200), ends=ends, origin=np.zeros(2))
    for place in (0.0, 3e7, -5e7):
        maps.update(np.zeros(1, np.int32), np.array([[place, -place, 0.3]]), beams)
        maps.clear(0)
