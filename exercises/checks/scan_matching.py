"""Checks of exercise 6: scan matching."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from checks.ekf_localization import differences
from gridslam.geometry.se2 import compose, transform_points

FloatArray = NDArray[np.float64]


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


def displacement_is_found(
    match: Callable[[FloatArray, FloatArray], FloatArray], seed: int, people: bool = False
) -> None:
    """`match(truth, guess)` -> pose, from up to 15 cm and 3 degrees away; a fifth of a 5 cm cell is asked for."""
    rng = np.random.default_rng(seed)
    truth = rng.uniform(-1, 1, 3) * [1.0, 0.8, np.pi]
    guess = compose(truth, rng.uniform(-1, 1, 3) * [0.15, 0.15, 0.05])
    found = np.asarray(match(truth, guess), np.float64)
    require(found.shape == (3,), f"expected a pose of shape (3,), got {found.shape}")
    require(bool(np.isfinite(found).all()), "the pose is not finite: the steps diverge")
    off = np.hypot(*(found - truth)[:2])
    before = np.hypot(*(guess - truth)[:2])
    turned = abs(math.remainder(found[2] - truth[2], math.tau))
    if off <= 0.01 and turned < 0.003:
        return
    where = f"the pose is {1000 * off:.0f} mm and {turned:.4f} rad off"
    if off > 1.5 * before + 0.02:
        why = "the steps lead away: the step is - (J' W J)^-1 J' W d"
    elif people:
        why = "people in front of the walls pull it: weigh each beam by 1 / (1 + (d / c)^2), c = 0.1 m"
    elif off < 0.8 * before:
        why = "the steps did not converge: repeat until they are small, each from the pose before"
    else:
        why = "it is hardly nearer than the guess: add each step to the pose"
    raise AssertionError(f"{where}; {why}")


Distance = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
Linearization = Callable[[Distance, FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


def scan_jacobian(linearize: Linearization) -> None:
    """`linearize(distance, pose, ends)` -> d (B,) and J (B, 3), against finite differences.

    Distances in the room have kinks where two walls are equally far; beams next to them are left out.
    """
    rng = np.random.default_rng(3)
    for _ in range(4):
        truth = rng.uniform(-1, 1, 3) * [1.0, 0.8, np.pi]
        pose = truth + rng.uniform(-1, 1, 3) * [0.1, 0.1, 0.05]
        ends = ends_in_room(truth)[::7]
        points = transform_points(pose, ends)
        off = np.abs(np.abs(points) - ROOM)
        smooth = (np.abs(off[:, 0] - off[:, 1]) > 0.05) & (off.min(axis=1) > 1e-3)
        d, gradient = distance_in_room(points)
        J = differences(lambda x: distance_in_room(transform_points(x, ends))[0], pose)  # noqa: B023
        c, s = math.cos(pose[2]), math.sin(pose[2])
        across = np.column_stack([-s * ends[:, 0] - c * ends[:, 1], c * ends[:, 0] - s * ends[:, 1]])
        local = np.column_stack([-ends[:, 1], ends[:, 0]])
        map_frame = np.column_stack([-points[:, 1], points[:, 0]])
        mirrored = np.column_stack([s * ends[:, 0] - c * ends[:, 1], c * ends[:, 0] + s * ends[:, 1]])
        turned = np.column_stack([c * gradient[:, 0] + s * gradient[:, 1], c * gradient[:, 1] - s * gradient[:, 0]])
        cross = np.column_stack([s * ends[:, 0] - c * ends[:, 1], c * ends[:, 0] - s * ends[:, 1]])
        crossed = np.column_stack([-s * ends[:, 0] - c * ends[:, 1], c * ends[:, 0] + s * ends[:, 1]])
        signs = (across * [-1.0, 1.0], across * [1.0, -1.0], -across, mirrored, cross, crossed)
        twice = np.column_stack([-s * points[:, 0] - c * points[:, 1], c * points[:, 0] - s * points[:, 1]])

        def with_heading(
            by_heading: FloatArray, by_position: FloatArray = gradient, gradient: FloatArray = gradient
        ) -> FloatArray:
            return np.column_stack([by_position, (gradient * by_heading).sum(axis=1)])

        wrong = {
            "the derivatives by the heading have a wrong sign" + " " * k: with_heading(value)
            for k, value in enumerate(signs)
        } | {
            "turn the ends by the heading before they are differentiated": with_heading(local),
            "the ends turn about the robot, not about the origin of the map: leave its position out": (
                with_heading(map_frame)
            ),
            "differentiate the ends as the laser sees them, not those that are transformed already": with_heading(
                twice
            ),
            "a turn moves the ends: the third column is missing": with_heading(np.zeros_like(across)),
            "the gradient is in the map frame already: do not turn it": with_heading(across, turned),
            "the derivative of a distance by the position is its gradient: the sign is wrong": (
                np.column_stack([-gradient, (gradient * across).sum(axis=1)])
            ),
            "the sign of the Jacobian is wrong": -with_heading(across),
        }
        got_d, got_J = linearize(distance_in_room, pose, ends)
        expect("distances", got_d, d, 1e-9, {"transform the ends to the map first": distance_in_room(ends)[0]})
        require(np.shape(got_J) == J.shape, f"Jacobian: expected shape {J.shape}, got {np.shape(got_J)}")
        select = {name: value[smooth] for name, value in wrong.items()}
        expect("Jacobian", np.asarray(got_J)[smooth], J[smooth], 1e-5, select)


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
        displacement_is_found(disturbed, seed, people=True)
