"""Check the numbers of a saved state when it is read, so that damage is not found scans later.

Types, shapes, counts and indices follow from the states themselves (`gridslam.serialization`); here are the ranges of
floats, by the names of the arrays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.io.measurement import FARTHEST_M
from gridslam.kernels import MOST_BEAM_CELLS, PAGE, TILE

_Arrays = Mapping[str, NDArray[Any]]

_POSE = re.compile(
    r"(^|\.)(poses?|key_pose|sensor_key_poses|matched_pose|inserted_pose|begin_pose|last_stored_pose|online_poses|online"
    r"|tracked|trunk|key_from_base|odometry|matched_odometry|begin_odometry|origins|measurement)$"
)
_UNKNOWN = re.compile(r"(^|\.)(odometry|matched_odometry|begin_pose|begin_odometry)$")  # NaN where there is none
_INFINITE = re.compile(r"(^|\.)(log_\w+|driven_since_found_m)$")
_POSITIVE = re.compile(
    r"(^|\.)((\w+_)?variances|\w*_m2|\w*_rad2|steps_m|(key_)?seconds|n_eff|latency_s|mass|segments|mean_step|inlier_ratio)$"
)
_LARGEST = 1e18
_NEAR_M = 1000.0  # no scan reaches farther


def require_plausible(arrays: _Arrays) -> None:
    """Refuse arrays of a saved run or localization that no run can leave.

    Raises
    ------
    ArgumentError
        Names the array, what was expected and what came.
    """
    for name, values in arrays.items():
        if values.dtype.kind == "f":
            _require_floats(name, values)


def require_near_maps(arrays: _Arrays, resolution_m: float) -> None:
    """Refuse poses of a saved state that are far from the maps which were drawn from there.

    Raises
    ------
    ArgumentError
        Names the array.
    """
    page_m = resolution_m * TILE * PAGE
    states = [name.removesuffix(".maps.first") for name in arrays if name.endswith(".maps.first")]
    for state, place in product(states, ("poses", "pose", "matched_pose")):
        poses = f"{state}.{place}"
        if poses not in arrays:
            continue
        first = arrays[f"{state}.maps.first"]
        low = page_m * first[::-1] - _NEAR_M  # of rows and columns, for x and y
        high = page_m * (first + arrays[f"{state}.maps.roots"].shape[1:])[::-1] + _NEAR_M
        places = np.atleast_2d(arrays[poses])[:, :2]
        far = places[~((places >= low) & (places <= high)).all(axis=1)]
        if len(far):
            raise ArgumentError(poses, f"poses on the map, from {low.tolist()} to {high.tolist()}", far[0].tolist())


def require_near_ends(arrays: _Arrays, resolution_m: float) -> None:
    """Refuse stored scans, whose arrays belong together, with beams that end where no map can reach.

    Raises
    ------
    ArgumentError
        Names the array.
    """
    limit_m = MOST_BEAM_CELLS * resolution_m
    for name in arrays:
        if name.endswith("scans.steps_m"):
            scans = name.removesuffix(".steps_m")
            steps_m = np.repeat(arrays[name], arrays[f"{scans}.ends.counts"])
            reach_m = float((steps_m * np.hypot(*arrays[f"{scans}.ends"].T.astype(np.float64))).max(initial=0.0))
            if not reach_m <= limit_m:
                raise ArgumentError(name, f"ends of beams within {limit_m:g} m of the robot", f"one at {reach_m:g} m")


def _require_floats(name: str, values: NDArray[Any]) -> None:
    most = FARTHEST_M if _POSE.search(name) else _LARGEST
    least = 0.0 if _POSITIVE.search(name) else -most
    good = (values >= least) & (values <= most)
    if _UNKNOWN.search(name):
        good |= np.isnan(values)
    if _INFINITE.search(name):
        good |= np.isinf(values) & ((values < 0) | ("log_" not in name))
    if not good.all():
        got = np.atleast_1d(values)[~np.atleast_1d(good)][0]
        raise ArgumentError(name, f"numbers from {least:g} to {most:g}", got)
