"""Exercise 11: the gmapping node, from topics to a map

The node slam_gmapping of ROS (Grisetti, Stachniss, Burgard, T-RO 2007), on the messages of a simulated bag. No ROS is
needed.
"""

# %% [markdown]
# A robot with ROS publishes messages on topics. A mapping node subscribes to some of them, and publishes others:
#
# | topic | message | |
# | --- | --- | --- |
# | `/scan` | sensor_msgs/LaserScan | in: ranges, angles and limits of a scan |
# | `/tf` | tf2_msgs/TFMessage | in: `odom` $\to$ `base_link`, the odometry; out: `map` $\to$ `odom` |
# | `/tf_static` | tf2_msgs/TFMessage | in: `base_link` $\to$ `laser`, the mounting |
# | `/map` | nav_msgs/OccupancyGrid | out: the map |
#
# `checks.simulated_bag()` returns the messages that a robot recorded. First the pose of a transform: a translation, and
# a quaternion $(x, y, z, w)$, which for a robot on a floor is $(0, 0, \sin\frac{\theta}{2}, \cos\frac{\theta}{2})$.

# %%
import math
from dataclasses import replace

import checks
import matplotlib.pyplot as plt
import numpy as np

import gridslam
from gridslam.config import override
from gridslam.geometry.se2 import between, compose

drive = checks.simulated_bag()
for name in ("/odom", "/tf", "/tf_static", "/scan"):
    print(name, sum(topic == name for topic, _ in drive.messages), "messages")


# %% [task]
def to_pose(transform):
    """Pose of a transform, seen from above.

    Parameters
    ----------
    transform : geometry_msgs/Transform
        `translation` with x, y, z in m; `rotation`, a quaternion with x, y, z, w.

    Returns
    -------
    (3,) float64
        [x m, y m, yaw rad].
    """
    q = transform.rotation
    yaw = math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y**2 + q.z**2))
    return np.array([transform.translation.x, transform.translation.y, yaw])


# %%
checks.planar_pose(to_pose)
print("passed")

# %% [markdown]
# Beam $k$ of a scan points to `angle_min` $+ \, k$ `angle_increment`. It has hit something if its range is at least
# `range_min` and below `range_max`. (A driver reports a beam without return as infinite, as NaN, as 0 or as
# `range_max`.)


# %% [task]
def to_beams(message):
    """Bearings of a scan, and which of its beams have hit something.

    Parameters
    ----------
    message : sensor_msgs/LaserScan
        angle_min, angle_increment in rad; range_min, range_max in m; ranges (B,) in m.

    Returns
    -------
    (B,) float64, (B,) bool
        Bearings in rad, in the frame of the laser; hits.
    """
    ranges = np.asarray(message.ranges, np.float64)
    bearings = message.angle_min + message.angle_increment * np.arange(len(ranges))
    return bearings, (ranges >= message.range_min) & (ranges < message.range_max)


# %%
checks.scan_message(to_beams)
print("passed")

# %% [markdown]
# The node does not process every scan. One is due when the robot has moved by `linearUpdate` (m) or turned by
# `angularUpdate` (rad) since the last one, or `temporalUpdate` seconds have passed. A negative `temporalUpdate`
# disables updates by time.


# %% [task]
def is_due(moved, elapsed_s, parameters):
    """Whether a scan is to be processed.

    Parameters
    ----------
    moved : (3,) float64
        Motion by odometry since the last scan that was processed: [x m, y m, theta rad].
    elapsed_s : float
        Seconds since then.
    parameters : mapping
        `linearUpdate`, `angularUpdate` and `temporalUpdate`.

    Returns
    -------
    bool
    """
    far = math.hypot(moved[0], moved[1]) >= parameters["linearUpdate"]
    turned = abs(moved[2]) >= parameters["angularUpdate"]
    late = 0 <= parameters["temporalUpdate"] <= elapsed_s
    return far or turned or late


# %%
checks.update_rule(is_due)
print("passed")

# %% [markdown]
# The node must not publish `map` $\to$ `base_link`: a frame has one parent, and that of `base_link` is `odom`. So it
# publishes `map` $\to$ `odom`, such that both together give the pose that it has estimated. (`compose(a, b)` is $a b$,
# and `between(a, b)` is $a^{-1} b$.)


# %% [task]
def map_from_odom(map_from_base, odom_from_base):
    """The transform that the node publishes.

    Parameters
    ----------
    map_from_base, odom_from_base : (3,) float64
        Estimated pose of the robot in the map, and its pose by odometry at the same time.

    Returns
    -------
    (3,) float64
        [x m, y m, theta rad] of `odom` in `map`.
    """
    return compose(map_from_base, between(odom_from_base, np.zeros(3)))


# %%
checks.map_to_odometry(map_from_odom)
print("passed")

# %% [markdown]
# The map goes out as a list of cells, row by row, the row of the least $y$ first: 100 (occupied) if the probability is
# above `occ_thresh`, 0 (free) otherwise, and -1 where nothing is known.


# %% [task]
def to_data(grid, occ_thresh):
    """Cells of a nav_msgs/OccupancyGrid.

    Parameters
    ----------
    grid : OccupancyGrid
        `probability` and `known`, (H, W), [row = y, column = x].
    occ_thresh : float
        Probability above which a cell is occupied.

    Returns
    -------
    (H * W,) int8
    """
    occupied = np.where(grid.probability > occ_thresh, 100, 0)
    return np.where(grid.known, occupied, -1).astype(np.int8).ravel()


# %%
checks.map_message(to_data)
print("passed")

# %% [markdown]
# The node itself: it keeps the newest odometry and the mounting, and hands scans that are due to the filter of exercise
# 10, here gridslam's preset `gmapping`, which has GMapping's parameters.


# %%
def run_node(messages, parameters, rng):
    """Stamps and poses of the scans that were processed, and the map."""
    values = [f"resolution_m={parameters['delta']}", f"resample_below={parameters['resampleThreshold']}"]
    configuration = gridslam.preset("gmapping", particles=int(parameters["particles"]))
    slam = gridslam.build(override(configuration, *values))
    slam = replace(slam, when_to_update=lambda translation_m, rotation_rad: True)
    state = mounting = odometry = last = last_ns = None
    stamps, poses = [], []
    for topic, message in messages:
        if topic in ("/tf", "/tf_static"):
            for link in message.transforms:
                if link.child_frame_id == "base_link":
                    odometry = to_pose(link.transform)
                elif link.child_frame_id == "laser":
                    mounting = to_pose(link.transform)
        if topic != "/scan" or odometry is None or mounting is None:
            continue
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        if state is not None and not is_due(between(last, odometry), (stamp_ns - last_ns) * 1e-9, parameters):
            continue
        bearings, hits = to_beams(message)
        geometry = gridslam.ScanGeometry.planar(bearings, mounting)
        ranges = np.where(hits, message.ranges, np.nan)
        scan = gridslam.LaserScan.from_ranges(stamp_ns, ranges, geometry, range_max_m=message.range_max)
        measured = gridslam.Odometry(stamp_ns, odometry)
        state, report = slam.step(state, measured, scan, rng) if state else slam.init(measured, scan)
        last, last_ns = odometry, stamp_ns
        stamps.append(stamp_ns)
        poses.append(report.pose)
    return np.array(stamps), np.array(poses), state.maps.occupancy(state.best)


# %%
checks.node_maps_the_rooms(run_node)
print("passed")

# %% [markdown]
# **What the parameters do.** Compare the error, the number of processed scans and the time:
#
# - `particles`: hypotheses of the trajectory; more of them close larger loops, and each has a map of its own.
# - `linearUpdate`, `angularUpdate`: how rarely a scan is processed; larger values save time until scans overlap too
#   little to be matched.
# - `resampleThreshold`: resampling below this share of the particles; 1 resamples always, and loses hypotheses.
# - `delta`: size of a cell; smaller cells cost time and memory, larger ones blur the walls.
# - `occ_thresh`: which cells of the published map are obstacles; it does not change the filter.

# %%
index = drive.truth.stamps_ns
changes = (
    {},
    {"particles": 1},
    {"linearUpdate": 0.3, "angularUpdate": 0.2},
    {"linearUpdate": 3.0, "angularUpdate": 1.5},
    {"delta": 0.2},
)
for change in changes:
    stamps, poses, grid = run_node(drive.messages, checks.PARAMETERS | change, np.random.default_rng(0))
    truth = drive.truth.poses[np.searchsorted(index, stamps)]
    error = checks.worst_error(poses, truth)
    print(f"{change or 'as they are'}: {len(stamps)} scans, {100 * error:.0f} cm off at most")

# %%
stamps, poses, grid = run_node(drive.messages, checks.PARAMETERS, np.random.default_rng(0))
image = to_data(grid, checks.PARAMETERS["occ_thresh"]).reshape(grid.known.shape)
height, width = image.shape
x, y = grid.origin
box = [x, x + width * grid.resolution_m, y, y + height * grid.resolution_m]
plt.imshow(np.where(image < 0, np.nan, 100 - image), origin="lower", cmap="gray", extent=box)
plt.plot(*poses[:, :2].T, "C0.-")
plt.show()
