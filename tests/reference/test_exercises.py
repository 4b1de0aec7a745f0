"""The checks of the exercises hold for gridslam's own algorithms; the notebooks are those of their sources.

Checks that a test of an algorithm calls itself are not repeated here.
"""

import json
import math

import checks
import make_notebooks
import numpy as np
import pytest
from feedback import expect

from gridslam import GraphSlam, GridFastSlam, KnownMap, MonteCarloLocalization
from gridslam.evaluation import absolute_errors
from gridslam.kernels.reference_update import ray_cells
from gridslam.localization.ekf import EkfLocalization, KnownLandmarks
from gridslam.models import OdometryMotion
from gridslam.models.landmark import NO_OBSERVATIONS, LandmarkObservations, RangeBearing
from gridslam.models.motion import GaussianIncrement
from gridslam.particles import Multinomial, ResamplingWheel, Systematic
from gridslam.particles.resampling import effective_sample_size
from gridslam.types import Trajectory

STILL = GaussianIncrement.from_std(np.zeros(3), np.zeros(3))


def test_odometry_motion():
    checks.odometry_motion(lambda poses, u, alphas, rng: OdometryMotion(*alphas)(u)(poses, rng))


def test_rays():
    checks.rays(lambda start, end: ray_cells(np.array(start), np.array([end])))


def test_inverse_sensor():
    checks.binary_bayes_filter(lambda sensor, hit: sensor.log_odds_hit if hit else sensor.log_odds_miss)


def test_ekf_localization():
    def predict(mean, P, increment, noise):
        ekf = EkfLocalization(KnownLandmarks.of([0], [[0.0, 0.0]]), RangeBearing())
        motion = GaussianIncrement.with_covariance(increment, noise)
        return belief(ekf.step(ekf.init(mean, P), motion, NO_OBSERVATIONS))

    def correct(mean, P, z, landmark, Q):
        sensor = RangeBearing(math.sqrt(Q[0, 0]), math.sqrt(Q[1, 1]))
        ekf = EkfLocalization(KnownLandmarks.of([7], landmark[None]), sensor)
        return belief(ekf.step(ekf.init(mean, P), STILL, LandmarkObservations.of(z[None], [7])))

    def belief(result):
        return result[0].pose, result[0].covariance

    checks.prediction_is_linearized(predict)
    checks.correction_is_linearized(correct)


def test_low_variance_resampling():
    checks.low_variance_resampler(Systematic())


def test_a_resampler_is_recognized_by_the_variance_of_its_counts():
    assert checks.resampling(Systematic()) == checks.LOW_VARIANCE
    assert checks.resampling(ResamplingWheel()) == checks.WHEEL
    with pytest.raises(AssertionError, match="independent draws"):
        checks.resampling(Multinomial())


def wheel_of_the_lecture(weights, size, rng, greatest=2.0):
    """Begin at a random particle, and turn by steps between 0 and `greatest` of the largest weights."""
    index, beta, drawn = int(rng.random() * len(weights)), 0.0, []
    for _ in range(size):
        beta += rng.random() * greatest * max(weights)
        while beta > weights[index]:
            beta -= weights[index]
            index = (index + 1) % len(weights)
        drawn.append(index)
    return np.array(drawn)


def test_the_wheel_of_the_lecture_passes_where_it_is_right():
    assert checks.resampling(wheel_of_the_lecture) == checks.WHEEL
    with pytest.raises(AssertionError, match="twice the greatest weight"):
        checks.resampling(lambda weights, size, rng: wheel_of_the_lecture(weights, size, rng, greatest=0.5))


def test_free_poses_are_uniform():
    checks.poses_are_uniform(lambda grid, count, rng: KnownMap(grid).sample_poses(count, rng))


def test_a_mistake_is_named_and_another_difference_shown():
    with pytest.raises(AssertionError, match=r"^angle: wrap it$"):
        expect("angle", 4.0, 4.0 - math.tau, mistakes={"wrap it": 4.0})
    with pytest.raises(AssertionError, match=r"^angle: expected \[?1.*, got \[?2"):
        expect("angle", 2.0, 1.0, mistakes={"wrap it": 4.0})
    with pytest.raises(AssertionError, match="expected shape"):
        expect("angle", np.zeros(2), 1.0)
    with pytest.raises(AssertionError, match="expected numbers"):
        expect("angle", {}, [1.0, 2.0])
    expect("weights", [-np.inf, np.nan], [-np.inf, np.nan])


def test_monte_carlo_localization():
    def localize(grid, measurements, pose, rng):
        filter_ = MonteCarloLocalization(KnownMap(grid))
        state, poses = filter_.init_gaussian(pose, np.diag([0.01, 0.01, 0.0025]), rng), []
        for odometry, scan in measurements:
            state, report = filter_.step(state, odometry, scan, rng)
            poses.append(report.pose)
        return np.array(poses)

    checks.robot_is_tracked(localize)


def test_graph_slam():
    checks.graph_solver(lambda graph: GraphSlam(tolerance=1e-12, first_guess="given").solve(graph).poses)


def test_effective_sample_size():
    checks.effective_sample_size(effective_sample_size)


def test_grid_fastslam():
    def run(measurements, rng):
        slam, state, poses = GridFastSlam(), None, []
        for odometry, scan in measurements:
            state, report = slam.step(state, odometry, scan, rng) if state else slam.init(odometry, scan, 5)
            poses.append(report.pose)
        return np.array(poses)

    def step_again(measurement, poses, log_weights, rng):
        slam = GridFastSlam(when_to_update=lambda translation_m, rotation_rad: True)
        state, _ = slam.init(*measurement, poses)
        state.log_weights = log_weights
        state, _ = slam.step(state, *measurement, rng)
        return state.poses, state.log_weights, [state.maps.occupancy(row) for row in range(len(poses))]

    checks.survivors_keep_their_maps(step_again)
    checks.poor_odometry_is_corrected(run)


def test_the_drive_of_the_last_exercise_needs_a_correction():
    drive = checks.poor_drive()
    stamps = drive.truth.stamps_ns
    odometry = Trajectory(stamps, drive.odometry.poses)
    assert absolute_errors(odometry, drive.truth).trans_max_m > 5 * checks.BAND_M


def test_notebooks_are_those_of_their_sources():
    """After a change run exercises/make_notebooks.py."""
    made = make_notebooks.notebooks()
    assert set(made) == set(make_notebooks.HERE.glob("*.ipynb"))
    assert len(made) == 22
    assert [path.name for path, text in made.items() if path.read_text(encoding="utf-8") != text] == []


@pytest.mark.parametrize("path", sorted(make_notebooks.notebooks()), ids=lambda path: path.stem)
def test_notebooks_have_the_format_of_jupyter(path):
    """nbformat 4.4: the keys that its schema requires, and no outputs."""
    document = json.loads(path.read_text(encoding="utf-8"))
    assert (document["nbformat"], document["nbformat_minor"]) == (4, 4)
    assert document["metadata"]["kernelspec"].keys() >= {"name", "display_name"}
    for cell in document["cells"]:
        assert all(isinstance(line, str) for line in cell["source"])
        if cell["cell_type"] == "code":
            assert cell.keys() == {"cell_type", "execution_count", "metadata", "outputs", "source"}
            assert (cell["outputs"], cell["execution_count"]) == ([], None)
        else:
            assert cell.keys() == {"cell_type", "metadata", "source"}
            assert cell["cell_type"] == "markdown"


def test_a_function_without_its_body_keeps_signature_and_docstring():
    code = (
        'def f(x):\n    """Return x.\n\n    More.\n    """\n    y = x\n    return y\n\n\n'
        'def g():\n    """One."""\n    return 1'
    )
    assert make_notebooks.without_bodies(code) == (
        'def f(x):\n    """Return x.\n\n    More.\n    """\n    raise NotImplementedError\n\n\n'
        'def g():\n    """One."""\n    raise NotImplementedError'
    )
