"""Exercise 10: grid-based FastSLAM

*Probabilistic Robotics*, Table 13.4 (`FastSLAM_occupancy_grids`), with scan matching as in GMapping (Grisetti,
Stachniss, Burgard, T-RO 2007).
"""

# %% [markdown]
# All parts together: each particle has a pose, a weight and a map. At each scan
#
# 1. **predict**: sample the motion model (exercise 1);
# 2. **match**: move the particle to where the scan fits its map (exercise 6);
# 3. **weigh**: multiply the weight by the likelihood of the scan (exercise 2);
# 4. **map**: insert the scan into the particle's map (exercise 3);
# 5. **resample** if $N_{eff} = 1 / \sum_k (w^{[k]})^2 < N / 2$ (exercise 5).
#
# Your own parts would do, in Python loops slowly. Here gridslam's parts are used, whose maps are copied on write.
# First the effective sample size. Weights are logarithms, as products of likelihoods underflow.

# %%
import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.geometry.se2 import between
from gridslam.mapping import OccupancyGridMapping
from gridslam.matching import GaussNewton
from gridslam.models import CauchyEndPoint, OdometryMotion
from gridslam.particles import Systematic


# %% [task]
def effective_sample_size(log_weights):
    """1 / sum(w^2) of the normalized weights, from log weights (N,) of any scale."""
    weights = np.exp(log_weights - log_weights.max())
    return weights.sum() ** 2 / np.square(weights).sum()


# %%
checks.effective_sample_size(effective_sample_size)
print("passed")

# %% [markdown]
# The parts and how they are called:
#
# - `MOTION(increment)(poses, rng)` draws successors of poses (N, 3).
# - `MATCHER(maps, rows, poses, priors, beams).poses` are the matched poses (N, 3); `rows` are the maps, 0 to N - 1, and
#   `priors` (N, 3, 3) information that holds a pose at its guess, here zero.
# - `SENSOR(beams)(maps, rows, poses)` are log likelihoods (N,).
# - `MAPPER(maps, poses, beams)` inserts the scan into all maps, in place.
# - `Systematic()(weights, N, rng)` are the parents (N,); `maps.select(parents)` copies their maps, in place.

# %%
MOTION = OdometryMotion(alpha1=0.05, alpha2=0.02, alpha3=0.02, alpha4=0.02)
MOTION, MATCHER, SENSOR, MAPPER = checks.recorded(MOTION, GaussNewton(), CauchyEndPoint(), OccupancyGridMapping())


# %% [task]
def step(maps, poses, log_weights, increment, beams, rng):
    """One step of grid-based FastSLAM.

    Parameters
    ----------
    maps : TileMaps
        One for each particle; changed in place.
    poses : (N, 3) float64
        Of the particles before.
    log_weights : (N,) float64
        Of the particles before.
    increment : (3,) float64
        Motion since then by odometry, in the frame of the robot.
    beams : Beams
        The scan.
    rng : numpy.random.Generator

    Returns
    -------
    poses, log_weights : (N, 3), (N,) float64
        After the step; the log weights are all 0 after resampling.
    """
    count = len(poses)
    rows = np.arange(count, dtype=np.int32)
    poses = MOTION(increment)(poses, rng)
    poses = MATCHER(maps, rows, poses, np.zeros((count, 3, 3)), beams).poses
    log_weights = log_weights + SENSOR(beams)(maps, rows, poses)
    MAPPER(maps, poses, beams)
    if effective_sample_size(log_weights) < count / 2:
        parents = Systematic()(np.exp(log_weights - log_weights.max()), count, rng)
        maps.select(parents)
        poses = poses[parents]
        log_weights = np.zeros(count)
    return poses, log_weights


# %%
def map_drive(measurements, rng, count=10):
    """Pose (T, 3) of the best particle at each scan, and its map in the end."""
    maps, poses, log_weights = MAPPER.empty(count), np.zeros((count, 3)), np.zeros(count)
    before, path = measurements[0].odometry.pose, []
    for k, (odometry, scan) in enumerate(measurements):
        beams = scan.beams(0.05, 30.0)
        if k == 0:
            MAPPER(maps, poses, beams)
        else:
            poses, log_weights = step(maps, poses, log_weights, between(before, odometry.pose), beams, rng)
        before = odometry.pose
        path.append(poses[np.argmax(log_weights)])
    return np.array(path), maps.occupancy(int(np.argmax(log_weights)))


def step_again(measurement, poses, log_weights, rng):
    """Poses, log weights and maps of particles that have mapped a scan, after a step with the same scan."""
    maps, beams = MAPPER.empty(len(poses)), measurement.scan.beams(0.05, 30.0)
    MAPPER(maps, poses, beams)
    poses, log_weights = step(maps, poses, log_weights, np.zeros(3), beams, rng)
    return poses, log_weights, [maps.occupancy(row) for row in range(len(poses))]


# %% [markdown]
# The order matters, and is checked. A particle that is copied takes its map along. The drive's odometry strays by 0.7
# m; a pose of yours may be 0.1 m off.

# %%
checks.fastslam_step(step, MAPPER)
checks.survivors_keep_their_maps(step_again)
checks.poor_odometry_is_corrected(lambda measurements, rng: map_drive(measurements, rng)[0])
print("passed")

# %%
drive = checks.poor_drive()
path, grid = map_drive(drive.measurements, np.random.default_rng(0))
height, width = grid.known.shape
x, y = grid.origin
box = [x, x + width * grid.resolution_m, y, y + height * grid.resolution_m]
plt.imshow(np.where(grid.known, 1 - grid.probability, np.nan), origin="lower", cmap="gray", extent=box)
odometry = between(drive.odometry.poses[0], drive.odometry.poses)
plt.plot(*drive.truth.poses[:, :2].T, "k", *path[:, :2].T, "C0", *odometry[:, :2].T, "C1")
plt.legend(["truth", "best particle", "odometry"])
plt.show()
