"""Checks of exercise 5: Monte Carlo localization."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from feedback import expect, require
from numpy.typing import ArrayLike, NDArray

from gridslam import OccupancyGrid
from gridslam.io.measurement import Measurement
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rng = np.random.Generator


Resampler = Callable[[FloatArray, int, Rng], IntArray]
RESAMPLING_CASES: tuple[tuple[list[float], int], ...] = (
    ([0.9, 0.1], 2),
    ([0.1, 0.9], 2),
    ([1, 1, 1], 3),
    ([5, 0, 1, 0, 2, 4], 6),
    ([0, 0.05, 0.05, 0.9, 0], 5),
    ([1, 2, 3, 4], 1),
    ([1, 2, 3, 4], 7),
    ([3, 1, 1, 1, 1, 1, 1, 1, 10, 1], 4),
)
"""Weights of any scale, and how many are drawn."""


def z_scores(draw_counts: Callable[[], IntArray], expected: FloatArray, repetitions: int) -> FloatArray:
    """How many standard errors the mean counts lie from `expected`; a count that never varies must be exact."""
    counts = np.array([draw_counts() for _ in range(repetitions)])
    error = counts.mean(axis=0) - expected
    standard_error = counts.std(axis=0) / math.sqrt(repetitions)
    fixed = standard_error == 0
    np.testing.assert_allclose(error[fixed], 0, atol=1e-12)
    return np.asarray(np.where(fixed, 0.0, error / np.where(fixed, 1.0, standard_error)))


def counts_are_expected(resampler: Resampler, weights: Sequence[float], size: int) -> None:
    """Each index is drawn size * weight times on average.

    3000 repetitions and means of at least 0.1 a draw: the central limit theorem holds well. |z| > 5 has a chance of
    6e-7; with 5 resamplers x 36 counts a false alarm would come for one seed in 9000. The seed is fixed.
    """
    rng = np.random.default_rng(20)
    given = np.array(weights, dtype=np.float64)
    relative = given / given.max()

    def draw() -> IntArray:
        return np.bincount(resampler(given, size, rng), minlength=len(given))

    worst = np.abs(z_scores(draw, size * relative / relative.sum(), 3000)).max()
    assert worst < 5, f"of weights {weights} a mean count is {worst:.1f} standard errors off: it is N times the weight"


def low_variance_resampler(resampler: Resampler) -> None:
    """Table 4.4, `resampler(weights, size, rng)`: unbiased, and each count is the expected one, rounded up or down."""
    for weights, size in RESAMPLING_CASES:
        counts_are_expected(resampler, weights, size)
        expected = size * np.array(weights) / np.sum(weights)
        for seed in range(20):
            drawn = resampler(np.array(weights, float), size, np.random.default_rng(seed))
            counts = np.bincount(drawn, minlength=len(weights))
            close = (counts >= np.floor(expected - 1e-9)) & (counts <= np.ceil(expected + 1e-9))
            require(bool(close.all()), f"of weights {weights} {size} draws gave {counts.tolist()}")


LOW_VARIANCE = "low variance resampling: each count is the expected one, rounded up or down"
WHEEL = "a resampling wheel: unbiased, but its counts vary; low variance resampling takes equal steps"


def resampling(resampler: Resampler) -> str:
    """`resampler(weights, size, rng)`: unbiased; the answer states whether it is of low variance or a wheel.

    Of 40 equal weights the counts of low variance resampling do not vary, those of a wheel (steps uniform between 0
    and two weights) have a variance of 1/3 to 1/2 (a renewal process), and those of independent draws one of nearly 1.
    """
    equal = np.ones(40)
    rng = np.random.default_rng(3)
    drawn = np.asarray(resampler(equal, 40, rng))
    require(drawn.shape == (40,), f"expected 40 indices, got shape {drawn.shape}")
    require(np.issubdtype(drawn.dtype, np.integer), f"expected indices, integers, got {drawn.dtype}")
    require(bool(((drawn >= 0) & (drawn < 40)).all()), "an index is not in [0, N)")
    counts = np.array([np.bincount(resampler(equal, 40, rng), minlength=40) for _ in range(200)])
    variance = float(counts.var(axis=0).mean())
    fractional = np.array([0.5, 1.5, 1.0, 1.0])
    draws = {tuple(np.bincount(resampler(fractional, 4, rng), minlength=4).tolist()) for _ in range(50)}
    require(len(draws) > 1, "the result never varies: the first point is random, uniform in one step")
    require(
        variance < 1.3,
        f"counts of equal weights have a variance of {variance:.2f}: a wheel's steps are uniform between 0 and "
        "twice the greatest weight",
    )
    require(
        variance < 0.7,
        f"counts of equal weights have a variance of {variance:.2f}: these are independent draws, unbiased but of high "
        "variance; one random number serves for all points",
    )
    if variance > 0.05:
        _wheel_is_unbiased(resampler)
        return WHEEL
    some = np.array([resampler(np.array([0.0, 1.0, 3.0, 0.0]), 4, rng) for _ in range(20)])
    require(bool(((some == 1) | (some == 2)).all()), "a particle of weight 0 is drawn")
    low_variance_resampler(resampler)
    return LOW_VARIANCE


def _wheel_is_unbiased(resampler: Resampler) -> None:
    """Mean counts of 400 draws are those expected, but for one draw, by which a wheel's start may err."""
    rng = np.random.default_rng(4)
    weights = np.array([5.0, 0.0, 1.0, 0.0, 2.0, 4.0])
    counts = np.array([np.bincount(resampler(weights, 400, rng), minlength=6) for _ in range(200)])
    off = np.abs(counts.mean(axis=0) - 400 * weights / weights.sum())
    spread = counts.std(axis=0) / math.sqrt(len(counts))
    require(
        bool((off <= 1 + 5 * spread).all()),
        f"a resampling wheel that is biased: weights {weights.tolist()} were drawn {counts.mean(axis=0).round(1)} "
        "times on average; its steps are uniform between 0 and twice the greatest weight",
    )


Sampler = Callable[[FloatArray, Rng], FloatArray]
MclStep = Callable[[FloatArray, Sampler, Callable[[FloatArray], FloatArray], Rng], FloatArray]


def mcl_weights(step: MclStep) -> None:
    """`step(poses, sampler, log_likelihood, rng)`: particles at four places, whose likelihoods are known.

    4000 particles; a share p of them varies by sqrt(p / 4000), 0.011 at most; five times that is 0.055 of all.
    """
    count = 4000
    at = np.repeat(np.arange(4.0), count // 4)
    poses = np.column_stack([at, np.zeros((count, 2))])
    likelihoods = np.array([0.4, 0.05, 0.9, 0.15])
    nats = np.log(likelihoods)

    def sampler(before: FloatArray, rng: Rng) -> FloatArray:
        return np.asarray(before + np.array([10.0, 0.0, 0.0]))

    def shares(weights: ArrayLike) -> FloatArray:
        return np.asarray(np.divide(weights, np.sum(weights)))

    def drawn(offset: float) -> FloatArray:
        def log_likelihood(moved: FloatArray) -> FloatArray:
            return np.asarray((nats + offset)[np.rint(moved[:, 0]).astype(int) % 10 % 4])

        with np.errstate(all="ignore"):
            found = np.asarray(step(poses.copy(), sampler, log_likelihood, np.random.default_rng(0)))
        require(found.shape == (count, 3), f"expected particles of shape {(count, 3)}, got {found.shape}")
        places = np.rint(found[:, 0]).astype(int)
        require(not (places < 10).any(), "the particles are those of before the motion: resample the moved ones")
        return np.asarray(np.bincount(places - 10, minlength=4)[:4] / count)

    ranks = np.argsort(np.argsort(nats))
    not_logarithms = "the likelihood is exp of the log likelihood: weights are not the log likelihoods"
    wrong = {
        f"{not_logarithms} themselves": shares(-nats),
        f"{not_logarithms} less the least": shares(nats - nats.min()),
        "weights are the likelihoods, not their ranks": shares(ranks + 1.0),
        "weights are the likelihoods, not their ranks ": shares(ranks),
        "weights are the likelihoods, not their square roots": shares(np.sqrt(likelihoods)),
        "weights are the likelihoods, not their squares": shares(likelihoods**2),
        "particles that fit better have more weight: the sign is wrong": shares(1 / likelihoods),
        "the particles are not resampled by their weights": np.full(4, 0.25),
        "only the best particle is left: draw them in proportion to their weights": [0.0, 0.0, 1.0, 0.0],
    }
    name = "shares of the particles at four places"
    expect(name, drawn(0.0), shares(likelihoods), 0.03, wrong)
    sentence = "exp of hundreds of nats is 0: subtract the largest log likelihood first"
    far = drawn(-900.0)
    require(bool((np.abs(far - shares(likelihoods)) <= 0.03).all()), f"{name}: {sentence}")

    def jitter(before: FloatArray, rng: Rng) -> FloatArray:
        return np.asarray(before + rng.normal(0, 0.1, before.shape))

    noisy = step(poses.copy(), jitter, lambda moved: np.zeros(len(moved)), np.random.default_rng(1))
    require(len(np.unique(noisy[:, 1])) > 1, "the sampler draws a successor for each pose: move all particles by it")
    _moved_before_weighed(step, poses)


def _moved_before_weighed(step: MclStep, poses: FloatArray) -> None:
    """Particles are weighed where they are after the motion: it exchanges two places."""

    def exchange(before: FloatArray, rng: Rng) -> FloatArray:
        return np.column_stack([3.0 - before[:, 0], before[:, 1:]])

    def log_likelihood(moved: FloatArray) -> FloatArray:
        return np.asarray(np.where(moved[:, 0] == 3.0, 0.0, -50.0))

    found = np.asarray(step(poses.copy(), exchange, log_likelihood, np.random.default_rng(2)))
    require(
        bool((found[:, 0] == 3.0).all()),
        "particles are weighed where they are after the motion, each by its own log likelihood",
    )


def poses_are_uniform(draw: Callable[[OccupancyGrid, int, Rng], FloatArray]) -> None:
    """`draw(grid, count, rng)` -> poses (count, 3): uniform over the free cells of a map, and over all headings.

    20,000 poses in 4 x 3 parts of free space: shares vary by at most sqrt(0.1 / 20000) = 0.0022; five times that.
    """
    cell = 0.5
    known = np.ones((8, 10), np.bool_)
    known[:, 8:] = False
    log_odds = np.full((8, 10), -3.0, np.float32)
    log_odds[:2] = 3.0
    grid = OccupancyGrid(log_odds, known, cell, (-2.0, 1.0))
    poses = np.asarray(draw(grid, 20_000, np.random.default_rng(6)))
    require(poses.shape == (20_000, 3), f"expected poses of shape {(20_000, 3)}, got {poses.shape}")
    column, row = np.floor((poses[:, :2] - [-2.0, 1.0]) / cell).astype(int).T
    require(
        bool(((column >= 0) & (column < 10) & (row >= 0) & (row < 8)).all()),
        "a pose is outside of the map: x is origin[0] + column * resolution_m, and y origin[1] + row * resolution_m",
    )
    require(bool(known[row, column].all()), "a pose is in an unknown cell")
    require(
        bool((log_odds[row, column] < 0).all()),
        "a pose is in an occupied cell: cells are [row, column], and row 0 is at the least y",
    )
    places = np.histogram2d(poses[:, 0], poses[:, 1], bins=(4, 3), range=((-2.0, 2.0), (2.0, 5.0)))[0] / len(poses)
    require(bool((np.abs(places - 1 / 12) < 0.011).all()), f"poses are not uniform over free space: {places.round(3)}")
    inside = np.mod(poses[:, :2] / cell, 1.0)
    require(
        float(inside.std(axis=0).min()) > 0.25, "poses are uniform within a cell, too: not all at its corner or centre"
    )
    headings = np.histogram(poses[:, 2], bins=8, range=(-math.pi, math.pi))[0] / len(poses)
    require(bool((np.abs(headings - 1 / 8) < 0.012).all()), "headings are uniform in [-pi, pi)")


def robot_is_found(localize: Callable[[OccupancyGrid, Sequence[Measurement], Rng], FloatArray]) -> None:
    """`localize(grid, measurements, rng)` -> poses (T, 3), from no initial pose: the last ones within 0.3 m."""
    grid = office_map()
    log = office(2)
    part = slice(40, 160)
    poses = localize(grid, log.measurements[part], np.random.default_rng(0))
    off = np.hypot(*(poses - log.truth.poses[part])[-10:, :2].T)
    require(
        float(off.max()) < 0.3,
        f"after {(part.stop - part.start) / 4:.0f} s the pose is {off.max():.1f} m from the truth: not found",
    )


def office(seed: int) -> SimulatedLog:
    """Return a drive through the small office of `gridslam demo`, 4 scans a second; poses in the frame of its walls."""
    rng = np.random.default_rng(seed)
    return simulate(make_world("demo", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90, rate_hz=4.0), rng)


def office_map() -> OccupancyGrid:
    """Return the office's map, from the true poses of one drive."""
    log = office(1)
    maps = OccupancyGridMapping().empty(1)
    for measurement, pose in zip(log.measurements[::2], log.truth.poses[::2], strict=True):
        maps.update(np.zeros(1, np.int32), pose[None], measurement.scan.beams(0.05, 30.0))
    return maps.occupancy(0)


Localizer = Callable[[OccupancyGrid, Sequence[Measurement], FloatArray, Rng], FloatArray]


def robot_is_tracked(localize: Localizer) -> None:
    """`localize(grid, measurements, pose, rng)` -> poses (T, 3): within 0.15 m of the truth, 0.05 m on average.

    Another drive than that of the map, 25 s, three seeds. Odometry alone errs by up to 0.27 m, 0.13 m on average.
    """
    grid = office_map()
    log = office(2)
    part = slice(40, 140)
    for seed in range(3):
        poses = localize(grid, log.measurements[part], log.truth.poses[part.start], np.random.default_rng(seed))
        off = np.hypot(*(poses - log.truth.poses[part])[:, :2].T)
        require(off.max() < 0.15, f"seed {seed}: {off.max():.2f} m from the truth")
        require(off.mean() < 0.05, f"seed {seed}: {off.mean():.2f} m from the truth on average")
