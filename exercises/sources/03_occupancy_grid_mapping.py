"""Exercise 3: occupancy grid mapping

*Probabilistic Robotics*, Tables 4.2 (`binary_bayes_filter`), 9.1 (`occupancy_grid_mapping`) and 9.2
(`inverse_range_sensor_model`).
"""

# %% [markdown]
# The poses are known. Each cell is a binary Bayes filter, whose log-odds $l = \log \frac{p}{1 - p}$ grow by the
# evidence of each beam that ends in the cell (hit) or passes through it (miss):
#
# $$ l_t = l_{t-1} + \log \frac{p(z_t \mid \text{occupied})}{p(z_t \mid \text{free})} $$
#
# First the cells that a beam passes. A ray goes from the cell of the laser to the cell in which it ends, one cell at a
# time along its longer axis, and in each of them it is in the cell nearest to the straight line.

# %%
import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.geometry.se2 import transform_points
from gridslam.models import InverseSensorModel


# %% [task]
def free_cells(start, end):
    """Cells that a ray passes, without the one in which it ends.

    Parameters
    ----------
    start, end : (2,) int
        [row, column] of the laser and of the end.

    Returns
    -------
    (n, 2) int64
        From `start` on; n is the larger of the two differences.
    """
    start = np.array(start)
    difference = np.array(end) - start
    steps = np.abs(difference).max()
    k = np.arange(steps)[:, None]
    return start + np.floor_divide(2 * k * difference + steps, max(2 * steps, 1))


# %%
checks.rays(free_cells)
print("passed")

# %% [markdown]
# Now the evidence of one measurement. `sensor` has four probabilities: a beam ends in an occupied cell
# (`true_occupied`) or passes it (`false_free`), ends in a free cell (`false_occupied`) or passes it (`true_free`). The
# check compares the sum with Bayes' rule on the probabilities.


# %% [task]
def evidence(sensor, hit):
    """Nats that one beam adds to the log-odds of a cell.

    Parameters
    ----------
    sensor : InverseSensorModel
        The four probabilities.
    hit : bool
        Whether the beam ended in the cell; otherwise it passed.

    Returns
    -------
    float
        Above 0 if the cell is more probably occupied than before.
    """
    if hit:
        return np.log(sensor.true_occupied / sensor.false_occupied)
    return np.log(sensor.false_free / sensor.true_free)


# %%
checks.binary_bayes_filter(evidence)
print("passed")

# %% [markdown]
# Both together build a map of a simulated office. A cell in which a beam of a scan ends is not freed by the other beams
# of that scan. Try what changes without this rule.

# %%
log = checks.office(1)
corners = log.walls.reshape(-1, 2)
cell, origin = 0.1, corners.min(axis=0) - 1.0
shape = tuple(np.ceil((np.ptp(corners, axis=0) + 2.0) / cell).astype(int)[::-1])
log_odds = np.zeros(shape)
known = np.zeros(shape, bool)
sensor = InverseSensorModel()
for measurement, pose in list(zip(log.measurements, log.truth.poses, strict=True))[::8]:
    beams = measurement.scan.beams(0.05, 30.0)
    laser = transform_points(pose, beams.origin[None])
    laser, *ends = np.floor((np.concatenate([laser, transform_points(pose, beams.ends)]) - origin) / cell).astype(int)
    hit = {(row, column) for column, row in ends}
    for column, row in ends:
        for passed in map(tuple, free_cells(laser[::-1], (row, column))):
            known[passed] = True
            if passed not in hit:
                log_odds[passed] += evidence(sensor, False)
        log_odds[row, column] += evidence(sensor, True)
        known[row, column] = True
plt.imshow(np.where(known, 1 / (1 + np.exp(log_odds)), np.nan), origin="lower", cmap="gray")
plt.show()
