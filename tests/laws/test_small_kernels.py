"""Small kernels of localization and loop closure, and their NumPy twins."""

import math

import numpy as np
import pytest

from gridslam.kernels import reference
from gridslam.models.motion import GaussianIncrement

compiled = pytest.importorskip("gridslam.kernels._compiled")

BOTH = pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])


def covariances(rng, *shape):
    """Covariances (*shape[:-1], D, D) of D = shape[-1] variables."""
    root = rng.normal(size=(*shape, shape[-1]))
    return root @ root.swapaxes(-1, -2)


@pytest.mark.parametrize("is_isotropic", [False, True])
def test_many_poses_have_the_covariances_of_each_alone(is_isotropic):
    rng = np.random.default_rng(4)
    covariance = np.diag([0.3, 0.3, 0.1]) if is_isotropic else covariances(rng, 3)
    motion, poses = GaussianIncrement.with_covariance(rng.normal(size=3), covariance), rng.normal(size=(150, 3))
    alone = np.concatenate([motion.moments(pose[None])[1] for pose in poses])
    np.testing.assert_allclose(motion.moments(poses)[1], alone, atol=1e-12)


@pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])
@pytest.mark.parametrize(("n", "m", "words"), [(7, 5, 4), (1, 9, 1), (0, 3, 4), (3, 0, 4)])
def test_distances_count_the_bits_that_differ(kernels, n, m, words):
    rng = np.random.default_rng(n)
    a, b = (rng.integers(0, 2**64, (rows, words), dtype=np.uint64) for rows in (n, m))
    counted = [[sum((x ^ y).bit_count() for x, y in zip(r, s, strict=True)) for s in b.tolist()] for r in a.tolist()]
    found = kernels.hamming_distances(a, b)
    assert found.dtype == np.int32
    assert found.tolist() == counted


def belief(seed, count=300):
    """Poses about two places, one of them at a heading of a half turn, where it jumps; weights of a sum of 1."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(count, 3)) * [0.4, 0.4, 0.3] + [3.0, -7.0, math.pi]
    poses[: int(count * 0.15 * seed)] += [30.0, 0.0, 1.0]
    poses[:, 2] = (poses[:, 2] + math.pi) % math.tau - math.pi
    weights = rng.exponential(size=count)
    return poses, weights / weights.sum()


@pytest.mark.parametrize("seed", range(6))
def test_mean_shift_is_that_of_the_twin(seed):
    poses, weights = belief(seed)
    near = np.hypot(*(poses[:, :2] - poses[-1, :2]).T) < 0.7
    ours, theirs = (k.mean_shift(poses, weights, near, poses[-1], 1.0, 0.5, 3) for k in (compiled, reference))
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@BOTH
def test_the_moment_is_that_of_the_cluster_alone_or_of_all(kernels):
    """Weighted covariances by NumPy: what is far counts where the cluster has no more than half of the weight."""
    for seed, counted in ((2, "cluster"), (5, "all")):
        poses, weights = belief(seed)
        poses[:, 2] = np.random.default_rng(1).normal(size=len(poses)) * 0.05
        far = poses[:, 0] > 20
        centre, in_cluster, mass, squares, moment = kernels.mean_shift(poses, weights, ~far, poses[-1], 5.0, 3.0, 40)
        assert in_cluster == pytest.approx(weights[~far].sum())
        assert (in_cluster > 0.5) == (counted == "cluster")
        kept = ~far if counted == "cluster" else np.ones(len(poses), bool)
        assert (mass, squares) == pytest.approx((weights[kept].sum(), np.square(weights[kept]).sum()))
        np.testing.assert_allclose(centre, np.average(poses[~far], axis=0, weights=weights[~far]), atol=1e-9)
        away = poses[kept] - centre
        np.testing.assert_allclose(moment, (weights[kept, None] * away).T @ away, atol=1e-9)


@BOTH
def test_poses_on_marked_cells(kernels):
    rng = np.random.default_rng(3)
    mask, corner = rng.random((20, 30)) < 0.5, np.array([-4.0, 2.5])
    rows, columns = rng.integers(-4, 25, 500), rng.integers(-4, 35, 500)
    poses = np.column_stack([corner + (np.column_stack([columns, rows]) + rng.uniform(0.01, 0.99, (500, 2))) / 4] * 2)
    marked = kernels.are_true(mask, corner, 4.0, np.ascontiguousarray(poses[:, :3]))
    inside = (rows >= 0) & (rows < 20) & (columns >= 0) & (columns < 30)
    expected = [bool(i and mask[r, c]) for i, r, c in zip(inside, rows, columns, strict=True)]
    assert marked.dtype == np.bool_
    assert marked.tolist() == expected
    assert 100 < sum(expected) < 300


@BOTH
def test_what_is_no_number_or_beyond_all_numbers_is_on_no_cell(kernels):
    nowhere = np.array([[np.nan, 0.5, 0], [0.5, np.inf, 0], [-np.inf, np.nan, 0], [1e300, 1e300, 0]])
    with np.errstate(invalid="ignore", over="ignore"):
        marked = kernels.are_true(np.ones((4, 4), bool), np.zeros(2), 20.0, nowhere)
    assert marked.tolist() == [False] * 4


@pytest.mark.parametrize("seed", range(6))
def test_slots_are_those_of_the_twin(seed):
    """Also where points lie on ends, before all and beyond them, and in slots that are empty."""
    rng = np.random.default_rng(seed)
    ends = np.cumsum(rng.integers(0, 3, 50)).astype(np.float64)
    points = np.sort(np.append(rng.uniform(-1, ends[-1] + 1, 200), rng.choice(ends, 30)))
    slots = [kernels.slots_of(ends, points) for kernels in (compiled, reference)]
    assert slots[0].dtype == slots[1].dtype == np.int64
    np.testing.assert_array_equal(slots[0], slots[1])
    assert slots[0].tolist() == [int((ends <= point).sum()) for point in points]
    assert compiled.slots_of(ends, points[:0]).shape == (0,)
