"""The kernels of landmark filters: their NumPy twins, and the sensors' own Jacobians."""

import math

import numpy as np
import pytest

from gridslam.kernels import reference
from gridslam.kernels.reference_landmarks import DEPTH_BEARING, RANGE_BEARING, RELATIVE_POSITION
from gridslam.models.landmark import DepthBearing, RangeBearing, RelativePosition, linearize_calibrated
from gridslam.models.motion import GaussianIncrement

compiled = pytest.importorskip("gridslam.kernels._compiled")

SENSORS = {
    RANGE_BEARING: RangeBearing(),
    DEPTH_BEARING: DepthBearing(),
    RELATIVE_POSITION: RelativePosition(),
}
BOTH = pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])


def covariances(rng, *shape):
    """Covariances (*shape[:-1], D, D) of D = shape[-1] variables."""
    root = rng.normal(size=(*shape, shape[-1]))
    return root @ root.swapaxes(-1, -2)


def case(seed, particles=40, landmarks=7):
    """Particles all around, headings beyond a turn too; some of their landmarks, and one observation of them."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(particles, 3)) * [20.0, 20.0, 4.0]
    rows = np.sort(rng.permutation(particles)[: particles - 5])
    return {
        "poses": poses,
        "calibration": rng.normal(size=(particles, 2)) * 0.2 if seed % 3 else np.empty((0, 2)),
        "positions": poses[:, None, :2] + rng.normal(size=(particles, landmarks, 2)) * 10,
        "covariances": covariances(rng, particles, landmarks, 2),
        "rows": rows,
        "columns": rng.integers(landmarks, size=len(rows)),
        "pose_covariances": covariances(rng, len(rows), 3) if seed % 2 else np.empty((0, 3, 3)),
        "measured": rng.normal(size=2) * [10, 3],
        "noise": covariances(rng, 2),
    }


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("sensor", SENSORS)
def test_predictions_are_those_of_the_twin(sensor, seed):
    given = case(seed)
    for ours, theirs in zip(
        compiled.predict_landmarks(sensor, **given), reference.predict_landmarks(sensor, **given), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@BOTH
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensor_without_errors_is_one_of_errors_of_zero(sensor, kernels):
    given = case(3)
    zeros = kernels.predict_landmarks(sensor, **{**given, "calibration": np.zeros((len(given["poses"]), 2))})
    none = kernels.predict_landmarks(sensor, **given)
    assert none[4].shape == (0, 2, 2)
    for ours, theirs in zip(none[:4], zeros[:4], strict=True):
        np.testing.assert_array_equal(ours, theirs)


@BOTH
@pytest.mark.parametrize("sensor", SENSORS)
def test_predictions_are_those_of_the_sensor(sensor, kernels):
    given, model = case(1), SENSORS[sensor]
    rows, columns = given["rows"], given["columns"]
    residuals, innovations, by_pose, by_landmark, by_sensor = kernels.predict_landmarks(sensor, **given)
    predicted, *jacobians = linearize_calibrated(
        model, given["poses"][rows], given["positions"][rows, columns], given["calibration"][rows]
    )
    np.testing.assert_allclose(residuals, model.residual(given["measured"], predicted), atol=1e-9)
    for ours, theirs in zip((by_pose, by_landmark, by_sensor), jacobians, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    expected = by_landmark @ given["covariances"][rows, columns] @ by_landmark.swapaxes(1, 2) + given["noise"]
    expected += by_pose @ given["pose_covariances"] @ by_pose.swapaxes(1, 2)
    np.testing.assert_allclose(innovations, expected, rtol=1e-9)


@BOTH
@pytest.mark.parametrize(("width", "size"), [(2, 2), (3, 3), (3, 6), (8, 8)])
def test_update_is_that_of_the_information_filter(kernels, width, size):
    """Inverse covariances add up, P^-1 + H' Q^-1 H, and the mean is that of both: another way to the same numbers."""
    rng = np.random.default_rng(size)
    P, means = covariances(rng, 9, size), rng.normal(size=(9, width))
    rows, H, Q = np.array([5, 0, 7]), rng.normal(size=(3, 2, size)), covariances(rng, 3, 2)
    residuals = rng.normal(size=(3, 2))
    S = H @ P[rows] @ H.swapaxes(1, 2) + Q
    after, moved = P.copy(), means.copy()
    shifts, gains = kernels.kalman_update(moved, after, rows, H, S, residuals)
    both = np.linalg.inv(P[rows]) + H.swapaxes(1, 2) @ np.linalg.solve(Q, H)
    expected = np.linalg.solve(both, H.swapaxes(1, 2) @ np.linalg.solve(Q, residuals[..., None]))[..., 0]
    np.testing.assert_allclose(after[rows], np.linalg.inv(both), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(shifts, expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose((gains @ residuals[..., None])[..., 0], shifts, atol=1e-12)
    np.testing.assert_array_equal(moved[rows], means[rows] + shifts[:, :width])
    untouched = np.setdiff1d(np.arange(9), rows)
    np.testing.assert_array_equal(after[untouched], P[untouched])
    np.testing.assert_array_equal(moved[untouched], means[untouched])


@BOTH
def test_what_has_no_variance_is_drawn_as_it_is(kernels):
    rng = np.random.default_rng(0)
    C = covariances(rng, 50, 3)
    C[::2, 1], C[::2, :, 1] = 0.0, 0.0
    means, numbers = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    drawn = kernels.draw_gaussians(means, C, numbers)
    np.testing.assert_array_equal(drawn[::2, 1], means[::2, 1])
    np.testing.assert_allclose(
        drawn[1::2], means[1::2] + (np.linalg.cholesky(C[1::2]) @ numbers[1::2, :, None])[..., 0], rtol=1e-9, atol=1e-9
    )
    np.testing.assert_array_equal(drawn, reference.draw_gaussians(means, C, numbers))


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
