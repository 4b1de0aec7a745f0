"""Laws that the algorithms of the exercises fulfil. gridslam's own tests call the same functions.

Each check takes an implementation as a function, and raises AssertionError where the law does not hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam import OccupancyGrid, PoseGraph, Trajectory
from gridslam.evaluation import absolute_errors
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.io.measurement import Measurement
from gridslam.mapping import OccupancyGridMapping
from gridslam.models import BeamRangeFinder, InverseSensorModel, LikelihoodField
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, RangeBearing, RelativePosition
from gridslam.models.motion import GaussianIncrement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.slam.landmarks.ekf_slam import EkfSlam

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rng = np.random.Generator


# 1: motion models


def samples_have_moments(
    sample: Callable[[FloatArray, Rng], FloatArray], before: FloatArray, mean: FloatArray, covariance: FloatArray
) -> None:
    """Of 100,000 successors of the pose `before` (3,): mean (3,), covariance (3, 3), headings in [-pi, pi).

    Standard error of a mean: spread / sqrt(n); of a covariance at most spread_i spread_j sqrt(2/n). Five of each hold
    with a chance of a failure below 1e-4 over all entries. Noise of 3 % of a radian leaves a second-order bias below
    (0.03)^2 m and a relative change of covariance below 2 * 0.03^2.
    """
    n = 100_000
    samples = sample(np.tile(before, (n, 1)), np.random.default_rng(7))
    assert samples.shape == (n, 3), f"expected shape {(n, 3)}, got {samples.shape}"
    assert ((samples[:, 2] >= -math.pi) & (samples[:, 2] < math.pi)).all(), "a heading is not in [-pi, pi)"
    errors = samples - mean
    errors[:, 2] = wrap(errors[:, 2])
    spread = np.sqrt(np.diag(covariance))
    np.testing.assert_array_less(np.abs(errors.mean(axis=0)), 5 * spread / math.sqrt(n) + 0.03**2)
    tolerance = np.outer(spread, spread) * (5 * math.sqrt(2 / n) + 2 * 0.03**2)
    np.testing.assert_array_less(np.abs(errors.T @ errors / n - covariance), tolerance + 1e-15)


def odometry_motion(sample: Callable[[FloatArray, FloatArray, Sequence[float], Rng], FloatArray]) -> None:
    """Table 5.6, `sample(poses, increment, alphas, rng)`: three increments whose covariances are known by hand.

    1 m ahead: var(rot1) = var(rot2) = alpha2, var(trans) = alpha3, and y moves with rot1 by 1 m/rad. 1 m to the left:
    rot1 = -rot2 = pi/2, and x moves with rot1 by -1 m/rad. Half a radian on the spot: rot2 alone.
    """
    alphas = a1, a2, a3, a4 = 1e-4, 2e-4, 3e-4, 4e-4
    rot = a1 * math.pi**2 / 4 + a2
    known = (
        ([1.0, 0.0, 0.0], [[a3, 0, 0], [0, a2, a2], [0, a2, 2 * a2]]),
        ([0.0, 1.0, 0.0], [[rot, 0, -rot], [0, a3 + a4 * math.pi**2 / 2, 0], [-rot, 0, 2 * rot]]),
        ([0.0, 0.0, 0.5], [[a4 / 4, 0, 0], [0, 0, 0], [0, 0, a1 / 4]]),
    )
    before = np.array([3.0, -2.0, 3.0])  # heading near pi: samples fall on both sides of the seam
    c = math.cos(before[2])
    s = math.sin(before[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    for increment, covariance in known:
        moved = np.array(increment)

        def drawn(poses: FloatArray, rng: Rng, moved: FloatArray = moved) -> FloatArray:
            return sample(poses, moved, alphas, rng)

        samples_have_moments(drawn, before, compose(before, moved), turn @ np.array(covariance) @ turn.T)


# 2: sensor models


def beam_densities_sum_to_one(
    likelihoods: Callable[[BeamRangeFinder, FloatArray, FloatArray], FloatArray], expected: float, sigma: float
) -> None:
    """For a range expected in m and sigma_hit: the density below range_max and the probability of no return.

    The midpoint rule errs by half a step times the jumps of the density, that of the short readings at the expected
    range (at most 0.2 / 0.05 per metre) and that at the range 0 (none); gridslam's table of the normal by 2e-7.
    """
    model = BeamRangeFinder(z_hit=0.6, z_short=0.2, z_max=0.1, z_rand=0.1, sigma_hit_m=sigma, range_max_m=10.0)
    step = 10.0 / 100_000
    ranges = (np.arange(100_000) + 0.5) * step
    total = likelihoods(model, ranges, np.full(100_000, expected)).sum() * step
    total += likelihoods(model, np.array([10.0]), np.array([expected]))[0]
    assert abs(total - 1) < step / 2 * (0.2 / 0.05) + 1e-5, f"expected range {expected:.3g} m: the sum is {total:.6f}"


def beam_model(likelihoods: Callable[[BeamRangeFinder, FloatArray, FloatArray], FloatArray]) -> None:
    """Table 6.1, `likelihoods(model, ranges, expected)`: sums of 1, and densities by hand.

    At the expected range of 5 m: N(0) = 3.989423 per metre, and the exponential's e^-5 / (1 - e^-5) = 0.006783655. Two
    standard deviations behind the wall nothing is short any more.
    """
    model = BeamRangeFinder(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit_m=0.1, range_max_m=30.0)
    got = likelihoods(model, np.array([5.0, 5.2, 40.0]), np.full(3, 5.0))
    by_hand = [0.8 * 3.989423 + 0.1 * 0.006783655 + 0.05 / 30, 0.8 * 0.5399097 + 0.05 / 30, 0.05]
    np.testing.assert_allclose(got, by_hand, rtol=1e-6)
    for expected in (0.05, 0.3, 2.0, 9.9, 10.0, 12.0, math.inf):
        for sigma in (0.02, 0.1, 0.5):
            beam_densities_sum_to_one(likelihoods, expected, sigma)


def likelihood_field(log_likelihoods: Callable[[LikelihoodField, FloatArray], FloatArray]) -> None:
    """Table 6.3, `log_likelihoods(model, distances)`: values in closed form; gridslam's are float32, hence 1e-5."""
    model = LikelihoodField(z_hit=0.7, z_rand=0.2, z_max=0.1, sigma_hit_m=0.1, range_max_m=20)
    distances = np.array([0.0, 0.05, 0.1, 0.3, 2.0])
    peak = 0.7 / (math.sqrt(2 * math.pi) * 0.1)
    densities = [peak * math.exp(-0.5 * (d / 0.1) ** 2) + 0.2 / 20 for d in distances.tolist()]
    np.testing.assert_allclose(log_likelihoods(model, distances.astype(np.float32)), np.log(densities), rtol=1e-5)


# 3: occupancy grid mapping


def ray_is_connected(free: IntArray, start: Sequence[int], end: Sequence[int]) -> None:
    """Cells (n, 2) that a ray frees: from the laser's on, one step of the longer axis each, to just before the end."""
    steps = np.abs(np.subtract(end, start)).max()
    assert len(free) == steps, f"expected {steps} cells from {start} to {end}, got {len(free)}"
    if steps:
        path = np.concatenate([along(free, start, end), [end]])
        assert path[0].tolist() == list(start), f"the ray begins at {path[0].tolist()}, not at {start}"
        moves = np.diff(path, axis=0)
        assert (np.abs(moves).max(axis=1) == 1).all(), "two cells of the ray are not neighbours"
        assert (moves * np.sign(np.subtract(end, start)) >= 0).all(), "the ray turns back"


def ray_is_straight(free: IntArray, start: Sequence[int], end: Sequence[int]) -> None:
    """Cells lie within half a cell of the line: on the shorter axis 2 |n (cell - start) - i d| <= n."""
    difference = np.subtract(end, start)
    steps = np.abs(difference).max()
    off = np.abs(steps * (along(free, start, end) - start) - np.arange(steps)[:, None] * difference)
    assert (2 * off <= steps).all(), f"from {start} to {end} a cell is more than half a cell off the line"


def along(cells: IntArray, start: Sequence[int], end: Sequence[int]) -> IntArray:
    """Cells in the order in which the ray passes them: by the axis on which it goes further."""
    difference = np.subtract(end, start)
    axis = int(np.argmax(np.abs(difference)))
    return cells[np.argsort(cells[:, axis] * np.sign(difference[axis]), kind="stable")]


def rays(free_cells: Callable[[Sequence[int], Sequence[int]], IntArray]) -> None:
    """`free_cells(start, end)` -> cells (n, 2) = [row, column]: 500 rays in all directions."""
    rng = np.random.default_rng(0)
    pairs = rng.integers(-70, 71, (500, 2, 2)).tolist()
    for start, end in [*pairs, [[0, 0], [0, 9]], [[3, 3], [-6, 3]], [[0, 0], [5, 5]], [[2, 1], [2, 1]]]:
        free = np.asarray(free_cells(start, end)).reshape(-1, 2)
        ray_is_connected(free, start, end)
        if start != end:
            ray_is_straight(free, start, end)


def cell_follows_bayes_rule(
    log_odds_after: Callable[[str], float], sensor: InverseSensorModel, measured: str, rounding: float = 1e-12
) -> None:
    """Compare a cell's log-odds after each measurement, h (hit) or m (miss), with Bayes' rule on probabilities.

    `rounding` is the error of storing the log-odds once.
    """
    belief = 0.5
    for n, z in enumerate(measured, 1):
        if_occupied = sensor.true_occupied if z == "h" else sensor.false_free
        if_free = sensor.false_occupied if z == "h" else sensor.true_free
        belief = if_occupied * belief / (if_occupied * belief + if_free * (1 - belief))
        off = abs(log_odds_after(measured[:n]) - math.log(belief / (1 - belief)))
        assert off <= n * rounding + 1e-5, f"after {measured[:n]} log-odds are {off:.3g} off Bayes' rule"


BAYES_CASES = (
    (0.9, 0.7, "hhmhmmmhhmhmhhh"),
    (0.6, 0.95, "mmmmhhmhm"),
    (0.3663, 0.9667, "hmmmmmmmhmh"),
    (0.99, 0.99, "hmhmhmmm"),
)
"""Probabilities that an occupied cell stops a beam and a free one does not, and measurements."""


def binary_bayes_filter(evidence: Callable[[InverseSensorModel, bool], float]) -> None:
    """`evidence(sensor, hit)` -> nats that a hit or a miss adds to the log-odds of a cell (Tables 4.2 and 9.2)."""
    for true_occupied, true_free, measured in BAYES_CASES:
        sensor = InverseSensorModel(true_occupied, 1 - true_occupied, 1 - true_free, true_free)

        def after(seen: str, sensor: InverseSensorModel = sensor) -> float:
            return sum(evidence(sensor, z == "h") for z in seen)

        cell_follows_bayes_rule(after, sensor, measured)


# 4: EKF localization


def differences(function: Callable[[FloatArray], FloatArray], at: FloatArray, step: float = 1e-6) -> FloatArray:
    """Central finite differences (n, N) of a function of (N,)."""
    columns = []
    for k in range(len(at)):
        ahead, behind = (np.array(at, float) for _ in range(2))
        ahead[k] += step
        behind[k] -= step
        columns.append((function(ahead) - function(behind)) / (2 * step))
    return np.stack(columns, axis=1)


Gaussian = tuple[FloatArray, FloatArray]
"""Mean (3,) and covariance (3, 3) of a pose."""


def prediction_is_linearized(predict: Callable[[FloatArray, FloatArray, FloatArray, FloatArray], Gaussian]) -> None:
    """`predict(mean, P, increment, M)`: the mean moves, and P is carried by the Jacobians of `compose`."""
    rng = np.random.default_rng(0)
    for _ in range(10):
        mean = np.array([*rng.normal(0, 3, 2), rng.uniform(-3, 3)])
        increment = rng.normal(0, 0.5, 3)
        P = _covariance(rng, 0.2)
        M = _covariance(rng, 0.05)
        G = differences(lambda x: compose(x, increment), mean)  # noqa: B023
        V = differences(lambda u: compose(mean, u), increment)  # noqa: B023
        moved, covariance = predict(mean, P, increment, M)
        np.testing.assert_allclose(between(compose(mean, increment), moved), 0, atol=1e-9)
        np.testing.assert_allclose(covariance, G @ P @ G.T + V @ M @ V.T, atol=1e-8)


def range_and_bearing(pose: FloatArray, landmark: FloatArray) -> FloatArray:
    """[range m, bearing rad] of a landmark (2,) from a pose (3,), without noise."""
    dx, dy = landmark - pose[:2]
    return np.array([math.hypot(dx, dy), math.remainder(math.atan2(dy, dx) - pose[2], math.tau)])


def correction_is_linearized(
    correct: Callable[[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray], Gaussian],
) -> None:
    """`correct(mean, P, z, landmark, Q)`: the Kalman filter's with the numerical Jacobian, also behind the robot."""
    rng = np.random.default_rng(1)
    Q = np.diag([0.01, 0.0004])
    landmark = np.array([1.0, 2.0])
    for bearing in 4 * (0.3, -1.2, math.pi - 0.001, -math.pi + 0.001):
        heading = rng.uniform(-3, 3)
        direction = bearing + heading
        mean = np.array([*(landmark - 3 * np.array([math.cos(direction), math.sin(direction)])), heading])
        P = _covariance(rng, 0.1)
        offset = np.array([0.05, math.copysign(0.01, bearing)])  # a bearing beyond pi comes round
        expected = range_and_bearing(mean, landmark)
        z = expected + offset
        z[1] = math.remainder(z[1], math.tau)
        H = differences(lambda x: _unwrapped(range_and_bearing(x, landmark), expected), mean)  # noqa: B023
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + Q)
        corrected, covariance = correct(mean, P, z, landmark, Q)
        np.testing.assert_allclose(corrected - mean - K @ offset, np.zeros(3), atol=1e-7)
        np.testing.assert_allclose(covariance, (np.eye(3) - K @ H) @ P, atol=1e-7)


def _unwrapped(z: FloatArray, near: FloatArray) -> FloatArray:
    return np.array([z[0], near[1] + math.remainder(z[1] - near[1], math.tau)])


def _covariance(rng: Rng, sigma: float) -> FloatArray:
    root = sigma * (np.eye(3) + 0.4 * rng.normal(size=(3, 3)))
    return np.asarray(root @ root.T)


# 5: Monte Carlo localization


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
    assert worst < 5, f"of weights {weights} a mean count is {worst:.1f} standard errors off"


def low_variance_resampler(resampler: Resampler) -> None:
    """Table 4.4, `resampler(weights, size, rng)`: unbiased, and each count is the expected one, rounded up or down."""
    for weights, size in RESAMPLING_CASES:
        counts_are_expected(resampler, weights, size)
        expected = size * np.array(weights) / np.sum(weights)
        for seed in range(20):
            drawn = resampler(np.array(weights, float), size, np.random.default_rng(seed))
            counts = np.bincount(drawn, minlength=len(weights))
            close = (counts >= np.floor(expected - 1e-9)) & (counts <= np.ceil(expected + 1e-9))
            assert close.all(), f"of weights {weights} {size} draws gave {counts.tolist()}"


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
        assert off.max() < 0.15, f"seed {seed}: {off.max():.2f} m from the truth"
        assert off.mean() < 0.05, f"seed {seed}: {off.mean():.2f} m from the truth on average"


# 6: scan matching


ROOM = np.array([3.02, 2.02])
"""Half the sides of a rectangular room, m."""
BEARINGS = np.deg2rad(np.arange(360) - 179.5)


def ends_in_room(pose: FloatArray) -> FloatArray:
    """Ends (360, 2) of beams in the robot's frame, of a laser at `pose` (3,) in the room."""
    angles = BEARINGS + pose[2]
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    ranges = ((ROOM * np.sign(directions) - pose[:2]) / directions).min(axis=1)
    return np.asarray(ranges[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)]))


def distance_in_room(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance (B,) in m of points (B, 2) to the nearest wall, and its gradient (B, 2)."""
    off = np.abs(points) - ROOM
    nearest = np.argmin(np.abs(off), axis=1)
    at = np.arange(len(points))
    gradient = np.zeros_like(points)
    gradient[at, nearest] = np.sign(off[at, nearest]) * np.sign(points[at, nearest])
    return np.abs(off[at, nearest]), gradient


def displacement_is_found(match: Callable[[FloatArray, FloatArray], FloatArray], seed: int) -> None:
    """`match(truth, guess)` -> pose, from up to 15 cm and 3 degrees away; a fifth of a 5 cm cell is asked for."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-1, 1, 3) * [1.0, 0.8, np.pi]
    found = match(truth, compose(truth, rng.uniform(-1, 1, 3) * [0.15, 0.15, 0.05]))
    np.testing.assert_allclose(found[:2], truth[:2], atol=0.01)
    off = abs(math.remainder(found[2] - truth[2], math.tau))
    assert off < 0.003, f"the heading is {off:.4f} rad off"


Distance = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


def scan_matcher(match: Callable[[Distance, FloatArray, FloatArray], FloatArray]) -> None:
    """`match(distance, guess, ends)` -> pose: eight displacements, without and with people in front of the walls."""

    def undisturbed(truth: FloatArray, guess: FloatArray) -> FloatArray:
        return match(distance_in_room, guess, ends_in_room(truth))

    def disturbed(truth: FloatArray, guess: FloatArray) -> FloatArray:
        ends = ends_in_room(truth)
        ends[40:70] *= 0.6  # 30 of 360 beams end before the wall
        return match(distance_in_room, guess, ends)

    for seed in range(8):
        displacement_is_found(undisturbed, seed)
        displacement_is_found(disturbed, seed)


# 7: EKF SLAM


class LandmarkMeasurements(NamedTuple):
    """What EKF SLAM and FastSLAM get in one step: control, its noise, landmarks by name and their measurements."""

    increment: FloatArray
    noise: FloatArray  # covariance (3, 3) of the increment
    names: list[int]
    z: FloatArray


SlamRun = Callable[[LandmarkModel, Sequence[LandmarkMeasurements]], tuple[FloatArray, FloatArray]]
"""Sensor and steps to the mean (3 + 2 L,) and covariance of pose and landmarks, in the order of first observation."""


def slam_is_the_kalman_filter(run: SlamRun) -> None:
    """A robot that cannot turn and measures positions: textbook equations over [x, y, m_1, m_2], in turn."""
    rng = np.random.default_rng(0)
    R = np.diag([0.04, 0.01])
    Q = np.diag([0.09, 0.25])
    big = 1e9  # a landmark of which nothing is known
    mean = np.zeros(6)
    P = np.diag([0, 0, big, big, big, big])
    steps = []
    for k in range(12):
        names = [[0, 1], [1], [0]][k % 3]
        z = rng.normal([[3.0, 1.0], [2.0, -2.0]], 0.5)[names]
        steps.append(LandmarkMeasurements(np.array([0.5, 0.1, 0.0]), np.diag([0.04, 0.01, 0.0]), names, z))
        mean[:2] += [0.5, 0.1]
        P[:2, :2] += R
        for j, value in zip(names, z, strict=True):
            H = np.zeros((2, 6))
            H[:, :2] = -np.eye(2)
            H[:, 2 + 2 * j : 4 + 2 * j] = np.eye(2)
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + Q)
            mean = mean + K @ (value - H @ mean)
            P = (np.eye(6) - K @ H) @ P
            P = (P + P.T) / 2
    found, covariance = run(RelativePosition(sigma_x_m=0.3, sigma_y_m=0.5), steps)
    some = [0, 1, 3, 4, 5, 6]  # all but the heading
    # The textbook's filter begins with a variance of 1e9, of which rounding leaves 1e9 * 2e-16 * a few.
    np.testing.assert_allclose(found[some], mean, atol=1e-5)
    np.testing.assert_allclose(covariance[np.ix_(some, some)], P, atol=1e-5)


RING = np.array([0.0, 4.0]) + 6.0 * np.column_stack(
    [np.cos(np.arange(12) * math.pi / 6), np.sin(np.arange(12) * math.pi / 6)]
)
"""Landmarks (12, 2) around the circle that `drive_in_a_circle` drives."""


def drive_in_a_circle(rng: Rng, count: int = 126) -> tuple[list[LandmarkMeasurements], FloatArray]:
    """Range and bearing of the landmarks within 5 m, once around a circle of 4 m radius; and the true poses."""
    sensor = RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02)
    increment = np.array([0.2, 0.0, 0.05])
    noise = np.diag(np.square([0.025, 0.025, 0.015]))
    pose = np.zeros(3)
    steps = []
    truth = []
    for _ in range(count):
        pose = compose(pose, increment + np.sqrt(np.diag(noise)) * rng.standard_normal(3))
        truth.append(pose)
        names = np.flatnonzero(np.hypot(*(RING - pose[:2]).T) < 5.0)
        z = sensor.linearize(pose, RING[names])[0] + [0.1, 0.02] * rng.standard_normal((len(names), 2))
        steps.append(LandmarkMeasurements(increment, noise, names.tolist(), z))
    return steps, np.array(truth)


def ring_is_mapped(run: SlamRun) -> None:
    """Final pose and landmarks of ten drives: errors as large as the covariance states.

    The normalized squared error of 27 numbers is chi-square distributed with a mean of 27, over ten drives with a
    standard deviation of sqrt(2 * 27 / 10) = 2.3; the band is four of these.
    """
    nees = []
    for seed in range(10):
        steps, truth = drive_in_a_circle(np.random.default_rng(seed))
        mean, P = run(RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02), steps)
        order = list(dict.fromkeys(name for step in steps for name in step.names))
        error = mean - np.concatenate([truth[-1], RING[order].ravel()])
        error[2] = wrap(error[2])
        nees.append(error @ np.linalg.solve(P, error))
    assert abs(np.mean(nees) - 27) < 4 * 2.3, f"normalized squared error {np.mean(nees):.1f}, expected 27"


# 8: FastSLAM


Particles = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Weights (N,), poses (N, 3), landmarks (N, L, 2) by name, and their covariances (N, L, 2, 2)."""
FastSlamRun = Callable[[LandmarkModel, Sequence[LandmarkMeasurements], int, Rng], Particles]


def particles_find_the_kalman_filter(run: FastSlamRun) -> None:
    """A robot that cannot turn and measures positions: the posterior of 20,000 particles is EKF SLAM's.

    Means err by sigma / sqrt(N_eff) = 0.3 / sqrt(1000) = 0.01 m; five times that. Variances by sqrt(2 / N_eff), 5 %.
    Resampling is left out: the weights are those of all measurements.
    """
    sensor = RelativePosition(sigma_x_m=0.3, sigma_y_m=0.3)
    increment = np.array([0.5, 0.0, 0.0])
    noise = np.diag(np.square([0.2, 0.2, 0.0]))
    seen = np.random.default_rng(8)
    ekf = EkfSlam(sensor)
    state = ekf.init()
    steps = []
    for k in range(4):
        z = np.array([[6.0, 1.0], [3.0, -2.0]]) - [0.5 * k, 0] + seen.normal(0, 0.3, (2, 2))
        steps.append(LandmarkMeasurements(increment, noise, [0, 1], z))
        motion = GaussianIncrement.with_covariance(increment, noise)
        state, _ = ekf.step(state, motion, LandmarkObservations.of(z, [0, 1]))
    expected = ekf.landmark_map(state)
    weights, poses, positions, covariances = run(sensor, steps, 20_000, np.random.default_rng(7))
    assert abs(weights.sum() - 1) < 1e-9, "the weights do not sum to 1"
    assert 1 / np.square(weights).sum() > 1000, "fewer than 1000 effective particles"
    mean = np.einsum("n,nlk->lk", weights, positions)
    away = positions - mean
    spread = np.einsum("n,nlj,nlk->ljk", weights, away, away) + np.einsum("n,nljk->ljk", weights, covariances)
    np.testing.assert_allclose(mean, expected.positions, atol=0.05)
    np.testing.assert_allclose(spread, expected.covariances, atol=0.2 * expected.covariances.max())
    np.testing.assert_allclose(weights @ poses, state.pose, atol=0.05)
    away = poses - weights @ poses
    spread = np.einsum("n,nj,nk->jk", weights, away, away)
    np.testing.assert_allclose(spread, state.pose_covariance, atol=0.2 * state.pose_covariance.max())


# 9: pose graphs


def ring_graph(rng: Rng, noise: float = 1.0) -> tuple[PoseGraph, FloatArray]:
    """Return a drive twice around a ring of 15 places with closures between the rounds, and its true poses (30, 3).

    `noise` scales standard deviations of 3 cm and 0.01 rad. The graph's poses are those of dead reckoning.
    """
    headings = math.tau * np.arange(30) / 15
    truth = np.column_stack([3 * np.sin(headings), 3 - 3 * np.cos(headings), wrap(headings)])
    edges = np.array([[k, k + 1] for k in range(29)] + [[k, k + 15] for k in range(0, 15, 2)])
    sigma = np.array([0.03, 0.03, 0.01])
    exact = between(truth[edges[:, 0]], truth[edges[:, 1]])
    z = compose(exact, noise * sigma * rng.standard_normal(exact.shape))
    guess = [truth[0]]
    for increment in z[:29]:
        guess.append(compose(guess[-1], increment))
    information = np.tile(np.diag(sigma**-2), (len(edges), 1, 1))
    return PoseGraph.of(np.array(guess), edges, z, information), truth


def is_a_minimum(graph: PoseGraph, poses: FloatArray, rng: Rng) -> None:
    """No small step from `poses` lowers chi2; slope against curvature. Pose 0 stays where it is."""
    chi2 = graph.chi2(poses)
    for _ in range(20):
        step = rng.normal(size=poses.shape)
        step[0] = 0.0
        up, down = (graph.chi2(poses + sign * 1e-4 * step) for sign in (1, -1))
        assert min(up, down) > chi2, "a step lowers chi2"
        assert abs(up - down) < 1e-3 * (up + down - 2 * chi2), "chi2 has a slope"


def edge_jacobians(
    linearize: Callable[[FloatArray, FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]],
) -> None:
    """`linearize(x_i, x_j, z)` -> e (3,), A and B (3, 3): e = z^-1 (x_i^-1 x_j), against finite differences."""
    rng = np.random.default_rng(2)
    for _ in range(10):
        x_i, x_j, z = rng.normal(0, 1, (3, 3))
        e, A, B = linearize(x_i, x_j, z)
        np.testing.assert_allclose(between(between(z, between(x_i, x_j)), e), 0, atol=1e-9)
        np.testing.assert_allclose(A, differences(_error_by(x_i, x_j, z, 0), x_i), atol=1e-7)
        np.testing.assert_allclose(B, differences(_error_by(x_i, x_j, z, 1), x_j), atol=1e-7)


def _error_by(x_i: FloatArray, x_j: FloatArray, z: FloatArray, which: int) -> Callable[[FloatArray], FloatArray]:
    """Error of an edge as a function of one of its poses, its heading near that at these."""
    at = between(z, between(x_i, x_j))[2]

    def error(x: FloatArray) -> FloatArray:
        e = between(z, between(*((x, x_j) if which == 0 else (x_i, x))))
        return np.array([*e[:2], at + math.remainder(e[2] - at, math.tau)])

    return error


def graph_solver(solve: Callable[[PoseGraph], FloatArray]) -> None:
    """`solve(graph)` -> poses (N, 3): the truth without noise, otherwise a minimum of chi2 at which pose 0 is held."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        exact, truth = ring_graph(rng, noise=0.0)
        displaced = exact.with_poses(truth + np.r_[np.zeros((1, 3)), rng.normal(0, 0.05, (29, 3))])
        np.testing.assert_allclose(between(truth, solve(displaced)), 0, atol=1e-6)
        graph, truth = ring_graph(rng)
        poses = solve(graph)
        np.testing.assert_array_equal(poses[0], graph.poses[0])
        is_a_minimum(graph, poses, rng)


# 10: grid-based FastSLAM


def effective_sample_size(n_eff: Callable[[FloatArray], float]) -> None:
    """`n_eff(log_weights)`: N of equal weights, 1 of a single one, and the same whatever all are multiplied with."""
    for log_weights, expected in (
        (np.zeros(8), 8.0),
        (np.log([0.5, 0.5, 1e-300, 1e-300]), 2.0),
        (np.log([1.0, 1e-300]), 1.0),
        (np.log([3.0, 1.0]), 1.6),
        (np.log([3.0, 1.0]) - 5000.0, 1.6),
    ):
        np.testing.assert_allclose(n_eff(log_weights), expected, rtol=1e-12)


def poor_drive() -> SimulatedLog:
    """Return the first 24 s (12 m) of a drive through an office with poor odometry; the truth starts at the origin.

    Aligned, the odometry alone strays from the truth by 0.68 m.
    """
    rng = np.random.default_rng(5)
    poor = OdometryNoise(distance_scale=1.03, turn_scale=0.93, bias_rad_per_m=0.01)
    whole = simulate(make_world("demo", rng), RobotConfig(), poor, LidarConfig(beams=120), rng)
    stamps = whole.truth.stamps_ns[:120]
    truth = Trajectory(stamps, between(whole.truth.poses[0], whole.truth.poses[:120]))
    odometry = Trajectory(stamps, whole.odometry.poses[:120])
    return SimulatedLog(whole.measurements[:120], truth, odometry, whole.walls)


def worst_error(poses: FloatArray, true_poses: FloatArray) -> float:
    """Largest distance (m) of a pose from the true one, the whole being aligned."""
    stamps = np.arange(len(poses)) * 10**9
    return absolute_errors(Trajectory(stamps, poses), Trajectory(stamps, true_poses)).trans_max_m


BAND_M = 0.1
"""Twice the worst error of the default filter on `poor_drive`, 0.05 m with 10 particles over 6 seeds."""


def poor_odometry_is_corrected(run: Callable[[Sequence[Measurement], Rng], FloatArray]) -> None:
    """`run(measurements, rng)` -> poses (T, 3) of all scans: two seeds of a drive through an office."""
    drive = poor_drive()
    for seed in range(2):
        worst = worst_error(run(drive.measurements, np.random.default_rng(seed)), drive.truth.poses)
        assert worst < BAND_M, f"seed {seed}: a pose is {worst:.2f} m from the truth"


FastSlamStep = Callable[[Measurement, FloatArray, FloatArray, Rng], tuple[FloatArray, FloatArray, list[OccupancyGrid]]]


def survivors_keep_their_maps(step: FastSlamStep) -> None:
    """`step(measurement, poses, log_weights, rng)` -> poses, log weights, maps: one of four particles has all weight.

    They are 40 m apart, have mapped the measurement, and get it again. All must end at the pose, and with the map, of
    the one that survives.
    """
    measurement = poor_drive().measurements[0]
    poses = np.array([[40.0 * k, 0.0, 0.0] for k in range(4)])
    log_weights = np.array([-1e3, -1e3, 0.0, -1e3])
    found, log_weights, maps = step(measurement, poses.copy(), log_weights, np.random.default_rng(0))
    assert np.abs(found - poses[2]).max() < 0.05, f"expected all poses near {poses[2]}, got {found.tolist()}"
    np.testing.assert_array_equal(log_weights, log_weights[0])
    for row, grid in enumerate(maps):
        x, _ = grid.origin
        assert 40 < x < 80, f"the map of particle {row} is that of another particle than its pose"
