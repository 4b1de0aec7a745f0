"""Normal equations of two scans' surfaces: twins, the slopes of the residuals, and what a step of them does."""

import math

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose, transform_points
from gridslam.grid.scan_batch import ScanBatch
from gridslam.kernels import reference
from gridslam.kernels.reference_surfaces import rank_bearings
from gridslam.matching.surfaces import Surfaces
from gridslam.types import StoredScan

compiled = pytest.importorskip("gridslam.kernels._compiled")

BEARINGS = np.linspace(-3.1, 3.1, 240)


def room_from(pose, noise_m=0.0, seed=0):
    """Ends of beams in a room of 8 m x 6 m about the origin, in the frame of a pose (3,)."""
    ways = np.column_stack([np.cos(BEARINGS + pose[2]), np.sin(BEARINGS + pose[2])])
    with np.errstate(divide="ignore"):
        reach = np.where(ways > 0, ([4.0, 3.0] - pose[:2]) / ways, ([-4.0, -3.0] - pose[:2]) / ways).min(axis=1)
    ranges = reach + noise_m * np.random.default_rng(seed).normal(size=len(reach))
    return ranges[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])


def seen_from(poses, noise_m=0.0):
    scans = [StoredScan(room_from(pose, noise_m, seed), np.zeros(2)) for seed, pose in enumerate(poses)]
    return Surfaces.of(ScanBatch.of(scans))


POSES = np.array([[0.0, 0.0, 0.0], [0.5, 0.3, 0.4], [-1.0, 0.6, 2.9], [0.4, -0.9, -2.0]])
PAIRS = np.array([[0, 1], [1, 2], [0, 3], [2, 3]])


@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("by_incidence", [True, False])
def test_twins(by_incidence, seed, both):
    rng = np.random.default_rng(seed)
    surfaces = seen_from(POSES, 0.01)
    poses = POSES + rng.normal(0, 0.03, POSES.shape)
    arguments = (*surfaces, poses, PAIRS, 0.2, 0.02, both, by_incidence, 1)
    found, expected = (kernels.match_surfaces(*arguments) for kernels in (compiled, reference))
    assert (expected[:, 9] > 50).all()
    np.testing.assert_array_equal(found[:, 9], expected[:, 9])
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("reach_m", [0.0, 0.15, 0.4])
@pytest.mark.parametrize("seed", range(5))
def test_twins_fit_lines_to_beams_in_any_order(seed, reach_m):
    rng = np.random.default_rng(seed)
    origins = rng.normal(0, 0.3, (len(POSES), 2))
    scans = [
        StoredScan(
            rng.permutation(room_from(pose, 0.01, k))[: 60 * (k + 1)] if seed else room_from(pose, 0.01, k), place
        )
        for k, (pose, place) in enumerate(zip(POSES, origins, strict=True))
    ]
    batch = ScanBatch.of([*scans, StoredScan(np.empty((0, 2)), np.zeros(2))])
    found, expected = (kernels.fit_surfaces(*batch, reach_m, 1) for kernels in (compiled, reference))
    assert len(expected[0]) > 50
    np.testing.assert_array_equal(found[3], expected[3])
    for own, other in zip(found[:3], expected[:3], strict=True):
        np.testing.assert_allclose(own, other, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("least_information", [0.02, 0.4, 2.0], ids=["all known", "one open", "both open"])
@pytest.mark.parametrize("seed", range(5))
def test_twins_match_to_surfaces(seed, least_information):
    rng = np.random.default_rng(seed)
    surfaces = seen_from(POSES[1:], 0.01)
    ends = room_from(POSES[0], 0.01)
    guess = tuple(rng.normal(0, 0.02, 3).tolist())
    prior = np.array([2500.0, 2000.0, 1e4])
    arguments = (ends, guess, prior, np.array([0.15, 0.08]), 0.02, least_information)
    found, expected = (kernels.match_to_surfaces(*surfaces, POSES[1:], *arguments) for kernels in (compiled, reference))
    assert found[1] == expected[1] > 100
    np.testing.assert_allclose(found[0], expected[0], rtol=0, atol=1e-9)
    if least_information < 0.1:
        assert np.abs(found[0]).max() < 0.004 < np.abs(guess).max()
    if least_information > 1:  # the position stays, and only the heading is matched
        np.testing.assert_allclose(found[0][:2], guess[:2], rtol=0, atol=1e-12)


def test_lines_with_a_reach_end_at_corners_and_take_the_noise_of_points():
    ends = room_from(np.zeros(3), 0.01)
    walls = np.array([4.0, 3.0])
    found = []
    for reach_m in (0.0, 0.3):
        surfaces = Surfaces.of(ScanBatch.of([StoredScan(ends, np.zeros(2))]), reach_m)
        across = np.abs(surfaces.normals).argmax(axis=1)
        away = np.abs(surfaces.points)[np.arange(len(across)), across] - walls[across]
        turned = np.abs(surfaces.normals).min(axis=1)
        at_corner = (walls - np.abs(surfaces.points)).max(axis=1) < 0.2
        found.append((int(at_corner.sum()), float(np.sqrt(np.square(away).mean())), float(np.sqrt(np.mean(turned**2)))))
    (few, spread, turn), (many, less_spread, less_turn) = found
    assert many > few
    assert less_spread < 0.8 * spread
    assert less_turn < 0.8 * turn


@pytest.mark.parametrize("reach_m", [0.0, 0.15])
def test_threads_change_nothing(reach_m):
    rng = np.random.default_rng(0)
    poses = np.tile(POSES, (25, 1)) + rng.normal(0, 0.03, (100, 3))
    scans = [StoredScan(room_from(pose, 0.01, k)[: 40 + 2 * k], np.zeros(2)) for k, pose in enumerate(poses)]
    one, several = (Surfaces.of(ScanBatch.of(scans), reach_m, threads) for threads in (1, 3))
    for own, other in zip(one, several, strict=True):
        np.testing.assert_array_equal(own, other)
    pairs = rng.integers(0, 100, (500, 2))
    found, other = (one.match(poses, pairs, 0.2, 0.02, threads=threads) for threads in (1, 3))
    assert found.counts.sum() > 5000
    np.testing.assert_array_equal(found.information, other.information)
    np.testing.assert_array_equal(found.gradients, other.gradients)


def test_ranks_ascend_with_bearings():
    ways = 7 * np.column_stack(
        [np.cos(np.linspace(-math.pi, math.pi, 999)), np.sin(np.linspace(-math.pi, math.pi, 999))]
    )
    assert (np.diff(rank_bearings(ways)[1:-1]) > 0).all()
    assert rank_bearings(np.zeros((1, 2))).tolist() == [0.0]


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
@pytest.mark.parametrize("both", [True, False])
def test_slopes_are_those_of_the_residuals(kernels, both):
    """The gradient of half the sum of squares, with a scale that makes all weights 1, by differences."""
    surfaces = seen_from(POSES)
    off = compose(POSES[:2], [[0.0, 0.0, 0.0], [0.02, -0.03, 0.01]])
    pair = PAIRS[:1]
    poses = np.concatenate([off, POSES[2:]])

    def half_squares(error):
        moved = poses.copy()
        moved[1] = compose(poses[1], error)
        row = kernels.match_surfaces(*surfaces, moved, pair, 0.5, 1e6, both, False, 1)[0]
        return row

    row = half_squares(np.zeros(3))
    step = 1e-6
    for axis in range(3):
        ahead, behind = (half_squares(sign * step * np.eye(3)[axis]) for sign in (1, -1))
        assert ahead[9] == behind[9] == row[9]
        slope = (ahead[6:9] - behind[6:9]) / (2 * step)
        information = row[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        np.testing.assert_allclose(slope, information[axis], rtol=0.1, atol=0.05 * np.abs(information).max())


@pytest.mark.parametrize("pair", PAIRS.tolist())
def test_steps_lead_to_the_true_relative_pose(pair):
    surfaces = seen_from(POSES)
    poses = POSES.copy()
    poses[pair[1]] = compose(poses[pair[1]], [0.04, -0.05, 0.02])
    for _ in range(8):
        found = surfaces.match(poses, np.array([pair]), 0.3, 0.02)
        poses[pair[1]] = compose(poses[pair[1]], -np.linalg.solve(found.information[0], found.gradients[0]))
    error = between(between(POSES[pair[0]], POSES[pair[1]]), between(poses[pair[0]], poses[pair[1]]))
    assert np.abs(error).max() < 2e-3  # lines through noiseless points, but for corners


def test_normals_are_those_of_the_walls_and_corners_have_none():
    surfaces = seen_from(POSES[:2])
    own = slice(surfaces.starts[1], surfaces.starts[2])
    places = transform_points(POSES[1], surfaces.points[own])
    normals = transform_points([0.0, 0.0, POSES[1, 2]], surfaces.normals[own])
    is_side = np.abs(np.abs(places[:, 0]) - 4) < 1e-6
    np.testing.assert_allclose(np.abs(normals[is_side]), np.tile([1.0, 0.0], (is_side.sum(), 1)), atol=0.08)
    assert ((surfaces.normals * surfaces.points).sum(axis=1) < 0).all()  # toward the laser
    corner = np.hypot(*(np.abs(places) - [4.0, 3.0]).T)
    assert corner.min() > 0.03
    assert 0.8 * len(BEARINGS) < len(places) < len(BEARINGS)


def test_nothing_seen_has_no_surfaces():
    empty = Surfaces.of(ScanBatch.of([StoredScan(np.empty((0, 2)), np.zeros(2))] * 2))
    assert empty.starts.tolist() == [0, 0, 0]
    both = empty.append(seen_from(POSES[:1]))
    assert both.match(np.zeros((3, 3)), np.array([[0, 2], [1, 0]]), 0.3, 0.02).counts.tolist() == [0, 0]


def test_what_does_not_belong_together_is_refused():
    surfaces = seen_from(POSES)
    for wrong in (np.array([[0, 4]]), np.array([[-1, 0]])):
        with pytest.raises(IndexError, match="pairs"):
            compiled.match_surfaces(*surfaces, POSES, wrong, 0.3, 0.02, True, False, 1)
    with pytest.raises(IndexError, match="poses"):
        compiled.match_surfaces(*surfaces, POSES[:2], PAIRS[:1], 0.3, 0.02, True, False, 1)
    own = surfaces.points, (0.0, 0.0, 0.0), np.ones(3), np.array([0.1]), 0.02, 0.02
    with pytest.raises(IndexError, match="poses"):
        compiled.match_to_surfaces(*surfaces, POSES[:2], *own)
    with pytest.raises(IndexError, match="starts"):
        compiled.fit_surfaces(surfaces.points, np.array([0, 9]), np.zeros((2, 2)), 0.0, 1)


def test_along_a_corridor_nothing_is_determined():
    """Noise turns the normals, and nearest points would hold the scans where they are."""
    rng = np.random.default_rng(0)
    along = np.linspace(-8, 8, 120)
    walls = np.concatenate([np.column_stack([along, np.full(120, y)]) for y in (-1.0, 1.0)])
    scans = [StoredScan(walls + rng.normal(0, 0.01, walls.shape), np.zeros(2)) for _ in range(2)]
    poses = np.array([[0.0, 0, 0], [0.3, 0.02, 0.0]])
    found = Surfaces.of(ScanBatch.of(scans)).match(poses, np.array([[0, 1]]), 0.3, 0.02)
    step = -np.linalg.solve(found.information[0] + 1e-3 * np.eye(3), found.gradients[0])
    assert found.counts[0] > 200
    assert abs(step[0]) < 1e-3
    assert -0.03 < step[1] < -0.01
    assert found.information[0, 0, 0] < 1e-3 * found.information[0, 1, 1]
