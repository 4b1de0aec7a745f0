"""Exercise 6: scan matching by Gauss-Newton

Kohlbrecher, von Stryk, Meyer, Klingauf, *A flexible and scalable SLAM system with full 3D motion estimation* (SSRR
2011), with the distance to the nearest obstacle as residual.
"""

# %% [markdown]
# Find the pose $x = (x, y, \theta)$ at which the ends $p_b$ of the beams lie on the walls. With $d(\cdot)$ the distance
# to the nearest wall and $q_b = t + R(\theta) p_b$ the end of beam $b$ in the map:
#
# $$ x^* = \arg\min_x \sum_b w_b \, d(q_b)^2, \qquad w_b = \frac{1}{1 + (d_b / c)^2} $$
#
# The Cauchy weights $w_b$, recomputed from the residuals of each iteration, keep beams that end before the wall
# (people) from pulling the pose. Linearize $d$: the row of beam $b$ in the Jacobian is
#
# $$ J_b = \nabla d(q_b)^\top \begin{pmatrix} 1 & 0 & -s\,p_x - c\,p_y \\ 0 & 1 & c\,p_x - s\,p_y \end{pmatrix} $$
#
# and iterate $\Delta = -(J^\top W J)^{-1} J^\top W d$, at most twenty times.

# %%
import math

import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.geometry.se2 import transform_points


# %% [task]
def linearize(distance, pose, ends):
    """Distances of the ends of a scan, and their derivatives by the pose.

    Parameters
    ----------
    distance : callable
        `distance(points)` of points (B, 2) in the map gives distances (B,) in m and their gradients (B, 2).
    pose : (3,) float64
        [x m, y m, theta rad].
    ends : (B, 2) float64, m
        Ends of the beams in the robot's frame; `transform_points(pose, ends)` brings them to the map.

    Returns
    -------
    d : (B,) float64, m
    J : (B, 3) float64
    """
    d, gradient = distance(transform_points(pose, ends))
    c = math.cos(pose[2])
    s = math.sin(pose[2])
    by_heading = gradient[:, 0] * (-s * ends[:, 0] - c * ends[:, 1]) + gradient[:, 1] * (
        c * ends[:, 0] - s * ends[:, 1]
    )
    return d, np.column_stack([gradient, by_heading])


# %%
checks.scan_jacobian(linearize)
print("passed")


# %% [task]
def match(distance, guess, ends):
    """Pose at which the ends of a scan fit the walls best.

    Parameters
    ----------
    distance : callable
        As of `linearize`.
    guess : (3,) float64
        [x m, y m, theta rad]; 15 cm and 3 degrees off at most.
    ends : (B, 2) float64, m
        Ends of the beams in the robot's frame.

    Returns
    -------
    (3,) float64
        The pose. Cauchy weights have the scale c = 0.1 m.
    """
    pose = np.array(guess)
    for _ in range(20):
        d, J = linearize(distance, pose, ends)
        w = 1 / (1 + np.square(d / 0.1))
        step = np.linalg.solve(J.T @ (w[:, None] * J), -J.T @ (w * d))
        pose += step
        if np.abs(step).max() < 1e-6:
            break
    return pose


# %% [markdown]
# The check displaces a scan of an empty room, and of one with people in it.

# %%
checks.scan_matcher(match)
print("passed")

# %%
truth, guess = np.array([0.5, -0.3, 0.8]), np.array([0.62, -0.42, 0.85])
ends = checks.ends_in_room(truth)
found = match(checks.distance_in_room, guess, ends)
plt.plot(*transform_points(guess, ends).T, "C1.", *transform_points(found, ends).T, "C0.", markersize=3)
plt.legend(["at the guess", f"matched, {1000 * np.hypot(*(found - truth)[:2]):.1f} mm off"])
plt.axis("equal")
plt.show()
