"""Exercise 4: EKF localization

*Probabilistic Robotics*, Table 7.2 (`EKF_localization_known_correspondences`).
"""

# %% [markdown]
# The belief is a Gaussian: a mean pose $\mu$ and a covariance $\Sigma$. An increment $u$ with covariance $M$ moves it:
#
# $$ \bar\mu = \mu \oplus u, \qquad \bar\Sigma = G \Sigma G^\top + V M V^\top $$
#
# with $\mu \oplus u = (x + c\,\Delta x - s\,\Delta y,\; y + s\,\Delta x + c\,\Delta y,\; \theta + \Delta\theta)$, $c
# = \cos\theta$, $s = \sin\theta$, and its Jacobians $G$ by the pose and $V$ by the increment.

# %%
import math

import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.geometry.se2 import compose


# %% [task]
def predict(mean, covariance, increment, noise):
    """Move the belief.

    Parameters
    ----------
    mean, covariance : (3,), (3, 3) float64
        By x, y in m and theta in rad.
    increment, noise : (3,), (3, 3) float64
        Increment in the frame of the robot, and its covariance.

    Returns
    -------
    (3,), (3, 3) float64
        Mean and covariance after the motion; theta in [-pi, pi) (`compose` of gridslam adds two poses).
    """
    c = math.cos(mean[2])
    s = math.sin(mean[2])
    dx, dy, _ = increment
    G = np.array([[1, 0, -s * dx - c * dy], [0, 1, c * dx - s * dy], [0, 0, 1]])
    V = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return compose(mean, increment), G @ covariance @ G.T + V @ noise @ V.T


# %%
checks.prediction_is_linearized(predict)
print("passed")

# %% [markdown]
# Range and bearing $z$ of a known landmark $(m_x, m_y)$ correct it. With $\delta = m - \mu_{xy}$, $q =
# \delta^\top\delta$:
#
# $$ \hat z = \begin{pmatrix} \sqrt q \\ \mathrm{atan2}(\delta_y, \delta_x) - \mu_\theta \end{pmatrix}, \quad
# H = \begin{pmatrix} -\delta_x / \sqrt q & -\delta_y / \sqrt q & 0 \\ \delta_y / q & -\delta_x / q & -1
# \end{pmatrix} $$
#
# $$ S = H \bar\Sigma H^\top + Q, \quad K = \bar\Sigma H^\top S^{-1}, \quad \mu = \bar\mu + K (z - \hat z), \quad
# \Sigma = (I - K H) \bar\Sigma $$
#
# The difference of two bearings must be in $[-\pi, \pi)$: a landmark behind the robot has bearings of both signs.


# %% [task]
def correct(mean, covariance, z, landmark, noise):
    """Correct the belief by one observation.

    Parameters
    ----------
    mean, covariance : (3,), (3, 3) float64
        The belief before.
    z : (2,) float64
        Range in m and bearing in rad.
    landmark : (2,) float64, m
        Its position in the map.
    noise : (2, 2) float64
        Covariance Q of the observation.

    Returns
    -------
    (3,), (3, 3) float64
        The belief after.
    """
    dx, dy = landmark - mean[:2]
    q = dx**2 + dy**2
    r = math.sqrt(q)
    innovation = z - [r, math.atan2(dy, dx) - mean[2]]
    innovation[1] = math.remainder(innovation[1], math.tau)
    H = np.array([[-dx / r, -dy / r, 0], [dy / q, -dx / q, -1]])
    S = H @ covariance @ H.T + noise
    K = covariance @ H.T @ np.linalg.inv(S)
    return mean + K @ innovation, (np.eye(3) - K @ H) @ covariance


# %%
checks.correction_is_linearized(correct)
print("passed")

# %% [markdown]
# A drive in a circle among landmarks, of which only two are in the map. The ellipses (five standard deviations) grow
# until one of these is observed.

# %%
steps, truth = checks.drive_in_a_circle(np.random.default_rng(3))
mean, covariance, path = np.zeros(3), np.zeros((3, 3)), []
angles = np.linspace(0, math.tau, 50)
for k, step in enumerate(steps):
    mean, covariance = predict(mean, covariance, step.increment, step.noise)
    for name, z in zip(step.names, step.z, strict=True):
        if name % 6 == 0:
            mean, covariance = correct(mean, covariance, z, checks.RING[name], np.diag([0.1**2, 0.02**2]))
    path.append(mean)
    if k % 6 == 0:
        root = np.linalg.cholesky(covariance[:2, :2])
        plt.plot(*(mean[:2, None] + 5 * root @ [np.cos(angles), np.sin(angles)]), "C1", linewidth=0.8)
plt.plot(*truth[:, :2].T, "k", *np.array(path)[:, :2].T, "C0")
plt.plot(*checks.RING[::6].T, "k*")
plt.axis("equal")
plt.show()
