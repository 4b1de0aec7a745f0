"""Exercise 1: sampling from the odometry motion model

*Probabilistic Robotics*, Table 5.6 (`sample_motion_model_odometry`).
"""

# %% [markdown]
# Odometry reports the increment of the pose between two times, $(\Delta x, \Delta y, \Delta\theta)$ in the frame of the
# first pose. The model takes it for a rotation, a translation and a rotation,
#
# $$ \delta_{rot1} = \mathrm{atan2}(\Delta y, \Delta x), \quad \delta_{trans} = \sqrt{\Delta x^2 + \Delta y^2}, \quad
# \delta_{rot2} = \Delta\theta - \delta_{rot1} $$
#
# and each of them has a Gaussian error $\varepsilon(v)$ of variance $v$:
#
# $$ r_1 = \delta_{rot1} + \varepsilon(\alpha_1 \delta_{rot1}^2 + \alpha_2 \delta_{trans}^2) $$
# $$ s = \delta_{trans} + \varepsilon(\alpha_3 \delta_{trans}^2 + \alpha_4 (\delta_{rot1}^2 + \delta_{rot2}^2)) $$
# $$ r_2 = \delta_{rot2} + \varepsilon(\alpha_1 \delta_{rot2}^2 + \alpha_2 \delta_{trans}^2) $$
#
# The robot turns by $r_1$, drives $s$ ahead and turns by $r_2$. Write a function that draws a successor for each of
# many poses. If the robot only turned, $\delta_{rot1} = 0$.

# %%
import math

import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.geometry.angles import wrap


# %% [task]
def sample_odometry(poses, increment, alphas, rng):
    """Draw one successor for each pose.

    Parameters
    ----------
    poses : (N, 3) float64
        [x m, y m, theta rad].
    increment : (3,) float64
        [x m, y m, theta rad] in the frame of the pose before.
    alphas : four floats
        Variances alpha_1 to alpha_4.
    rng : numpy.random.Generator

    Returns
    -------
    (N, 3) float64
        Theta in [-pi, pi); `wrap` brings any angle there.
    """
    dx, dy, turn = increment
    a1, a2, a3, a4 = alphas
    trans = math.hypot(dx, dy)
    rot1 = math.atan2(dy, dx) if trans > 0 else 0.0
    rot2 = math.remainder(turn - rot1, math.tau)
    sigma1 = math.sqrt(a1 * rot1**2 + a2 * trans**2)
    sigma_trans = math.sqrt(a3 * trans**2 + a4 * (rot1**2 + rot2**2))
    sigma2 = math.sqrt(a1 * rot2**2 + a2 * trans**2)
    count = len(poses)
    r1 = rng.normal(rot1, sigma1, count)
    s = rng.normal(trans, sigma_trans, count)
    r2 = rng.normal(rot2, sigma2, count)
    x = poses[:, 0] + s * np.cos(poses[:, 2] + r1)
    y = poses[:, 1] + s * np.sin(poses[:, 2] + r1)
    return np.stack([x, y, wrap(poses[:, 2] + r1 + r2)], axis=1)


# %% [markdown]
# The check draws 100,000 successors for four increments whose mean and covariance are known by hand.

# %%
checks.odometry_motion(sample_odometry)
print("passed")

# %% [markdown]
# The cloud of samples on a drive of eight increments: errors of heading bend it into a banana, which no Gaussian over
# x and y can represent.

# %%
rng = np.random.default_rng(0)
poses = np.zeros((500, 3))
for k in range(8):
    poses = sample_odometry(poses, np.array([1.0, 0.0, 0.1 if k > 3 else 0.0]), [0.01, 0.02, 0.001, 0.001], rng)
    plt.scatter(poses[:, 0], poses[:, 1], s=1)
plt.axis("equal")
plt.xlabel("x, m")
plt.ylabel("y, m")
plt.show()
