"""The picture of landmarks: ellipses where they belong, and everything in the frame."""

import numpy as np

from gridslam.types import Trajectory
from gridslam.viz.canvas import CLOSURE, TRUTH
from gridslam.viz.picture import SIGMAS, draw_landmarks, ellipse


def test_an_ellipse_has_its_distance_from_the_centre_everywhere():
    rng = np.random.default_rng(0)
    roots, centres = rng.normal(size=(5, 2, 2)), rng.normal(0, 9, (5, 2))
    covariances = roots @ roots.swapaxes(1, 2)
    offsets = ellipse(centres, covariances) - centres[:, None]
    distances = np.einsum("mki,mij,mkj->mk", offsets, np.linalg.inv(covariances), offsets)
    np.testing.assert_allclose(distances, SIGMAS**2, rtol=1e-8)
    np.testing.assert_allclose(offsets[:, 0], offsets[:, -1], atol=1e-12)
    singular = ellipse(centres[:1], np.zeros((1, 2, 2)))
    np.testing.assert_array_equal(singular[0], np.tile(centres[0], (49, 1)))


def _count(page, colour):
    return int((np.asarray(page) == colour).all(axis=2).sum())


def test_more_uncertain_landmarks_take_more_ink_and_truth_is_shown_where_there_is_any():
    angle = np.linspace(0, 6, 100)
    trajectory = Trajectory(np.arange(100) * 10**9, np.stack([angle, np.sin(angle), angle * 0], axis=1))
    positions = np.array([[1.0, 2.0], [4.0, -2.0]])
    small, large = (
        draw_landmarks(trajectory, positions, np.tile(spread * np.eye(2), (2, 1, 1)), title="a", caption=["b"])
        for spread in (1e-4, 0.02)
    )
    assert _count(large, CLOSURE) > _count(small, CLOSURE) > 0
    assert _count(large, TRUTH) == 0
    told = draw_landmarks(
        trajectory, positions, np.tile(0.02 * np.eye(2), (2, 1, 1)), truth=trajectory, true_positions=positions + 0.5
    )
    assert _count(told, TRUTH) > 100
    assert min(told.size) > 800
