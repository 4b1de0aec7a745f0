"""What the numbers of a saved state can be: a damaged one is found when it is read, not scans later.

Types and shapes follow from the states themselves (`gridslam.serialization`); here are the ranges of the values, by the
names of the arrays.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError
from gridslam.io.measurement import FARTHEST_M
from gridslam.kernels import MOST_BEAM_CELLS, PAGE, TILE

__all__ = ["require_near_ends", "require_near_maps", "require_plausible", "require_whole_piece"]

_Arrays = Mapping[str, NDArray[Any]]

_POSE = re.compile(
    r"(^|\.)(poses?|key_pose|sensor_key_poses|matched_pose|inserted_pose|begin_pose|last_stored_pose|online_poses|online"
    r"|tracked|trunk|key_from_base|odometry|matched_odometry|begin_odometry|origins|measurement)$"
)
_UNKNOWN = re.compile(r"(^|\.)(odometry|matched_odometry|begin_pose|begin_odometry)$")  # NaN where there is none
_INFINITE = re.compile(r"(^|\.)(log_\w+|driven_since_found_m)$")
_POSITIVE = re.compile(
    r"(^|\.)((\w+_)?variances|\w*_m2|\w*_rad2|steps_m|key_seconds|max_s|n_eff|latency_s|mass|segments|mean_step|inlier_ratio)$"
)
_LARGEST = 1e18
_MOST_PAGES = 1 << 21  # rows and columns of cells are numbers of 32 bits
_SUBMAP = 10  # key scans


_NEAR_M = 1000.0  # no scan reaches farther


class _Range(NamedTuple):
    low: float
    high: float


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
    for name, (low, high) in _index_ranges(arrays).items():
        values = arrays.get(name, np.zeros(0, np.int64))
        if values.dtype.kind in "iu":  # others are refused by the states
            _require_range(name, values, (values >= low) & (values <= high), _Range(low, high))
    _require_rows(arrays)
    _require_keys(arrays)


def require_whole_piece(arrays: _Arrays) -> None:
    """Refuse arrays of a saved piece whose key scans, scans and constraints do not belong together.

    Raises
    ------
    ArgumentError
        Names the array, what was expected and what came.
    """
    keys = len(arrays.get("graph.poses", ()))
    scans = int(arrays.get("scans.count", np.zeros(1, np.int64)).reshape(-1)[0])
    if not keys or arrays.get("scans.keys", np.zeros(0)).shape != (keys,):
        raise ArgumentError("scans.keys", f"{keys} key scans, at least one", arrays.get("scans.keys"))
    ranges = dict.fromkeys(("graph.constraints.from", "graph.constraints.to"), _Range(0, keys - 1))
    for name, limits in (ranges | {"scans.keys": _Range(0, scans - 1)}).items():
        values = arrays.get(name, np.zeros(0, np.int64))
        if values.dtype.kind == "i":
            _require_range(name, values, (values >= limits.low) & (values <= limits.high), limits)
    if (np.diff(arrays["scans.keys"].astype(np.float64)) <= 0).any():
        raise ArgumentError("scans.keys", "scans in order", arrays["scans.keys"])


def require_near_maps(arrays: _Arrays, resolution_m: float) -> None:
    """Refuse poses of a saved run that are far from the maps which were drawn from there.

    Raises
    ------
    ArgumentError
        Names the array.
    """
    page_m = resolution_m * TILE * PAGE
    for maps, poses in (
        ("state.maps", "state.poses"),
        ("state.tracker.maps", "state.tracker.pose"),
        ("state.tracker.maps", "state.tracker.matched_pose"),
        ("state.closure_state.correction.maps", "state.closure_state.correction.poses"),
    ):
        if poses not in arrays:
            continue
        first = arrays[f"{maps}.first"]
        low = page_m * first[::-1] - _NEAR_M  # of rows and columns, for x and y
        high = page_m * (first + arrays[f"{maps}.roots"].shape[1:])[::-1] + _NEAR_M
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
    _require_range(name, values, good, _Range(least, most))


def _require_range(name: str, values: NDArray[Any], good: NDArray[np.bool_], limits: _Range) -> None:
    if not good.all():
        got = np.atleast_1d(values)[~np.atleast_1d(good)][0]
        raise ArgumentError(name, f"numbers from {limits.low:g} to {limits.high:g}", got)


def _key_scans(arrays: _Arrays) -> int:
    trunk = arrays.get("state.ancestry.trunk", np.zeros((0, 3)))
    return len(np.atleast_1d(trunk)) + arrays.get("state.ancestry.counts", np.zeros(0)).size


def _index_ranges(arrays: _Arrays) -> dict[str, _Range]:
    """Ranges of numbers that are counts, or places in other arrays."""
    keys = _key_scans(arrays)
    shape = arrays.get("record.poses", np.zeros((0, 0, 3))).shape
    particles = shape[1] if len(shape) == 3 else 0
    scans = int(arrays.get("state.closure_state.scans.count", np.zeros(1, np.int64)).reshape(-1)[0])
    constraints = arrays.get("state.closure_state.graph.constraints.from", np.zeros(0)).size
    count = _Range(0, 1 << 62)
    key = _Range(0, keys - 1)
    submap = _Range(0, keys // _SUBMAP)
    closure = "state.closure_state"
    ranges = {
        "state.updates": count,
        "trajectory.keys": key,
        "statistics.counts": count,
        f"{closure}.rejected": count,
        f"{closure}.scans.keys": _Range(0, scans - 1),
        f"{closure}.scans.storage_interval": _Range(1, 1 << 31),
        f"{closure}.search.failures": count,
        f"{closure}.search.next_key_scan": _Range(0, 1 << 31),
        f"{closure}.search.near_submaps": submap,
        f"{closure}.search.ambiguity_submaps": submap,
        f"{closure}.pending_constraints.keys": _Range(1, keys),
        f"{closure}.pending_constraints.constraints": _Range(0, constraints),
        f"{closure}.pending_constraints.new": _Range(0, constraints),
        f"{closure}.pending_constraints.steps": count,
        f"{closure}.correction.inserted": _Range(0, keys),
        f"{closure}.joined": _Range(-1, 1 << 31),
        f"{closure}.joined_after": _Range(0, keys),
        "record.parents": _Range(0, particles - 1),
        "record.best": _Range(0, particles - 1),
    }
    ends = [f"{closure}.{part}.{end}" for part in ("graph.constraints", "unconfirmed") for end in ("from", "to")]
    ranges |= dict.fromkeys(ends, key)
    everywhere = {
        "maps.first": _Range(-_MOST_PAGES, _MOST_PAGES),
        "tracker.matched_map": _Range(0, 1),
        "tracker.scans": count,
        "tracker.unlocalized_scans": count,
        "tracker.rejected_odometry": count,
    }
    parts = {name: limits for name in arrays for part, limits in everywhere.items() if name.endswith(f".{part}")}
    return ranges | parts


def _require_rows(arrays: _Arrays) -> None:
    """What has a row for each key scan must have as many as the ancestry."""
    keys = _key_scans(arrays)
    for name in ("graph.poses", "online_poses", "scans.keys"):
        rows = arrays.get(f"state.closure_state.{name}")
        if rows is not None and rows.shape[:1] != (keys,):
            raise ArgumentError(f"state.closure_state.{name}", f"{keys} rows, one for each key scan", rows.shape)


def _require_keys(arrays: _Arrays) -> None:
    """Each scan belongs to the key scan at or before it, from the first to the last."""
    keys = arrays.get("trajectory.keys")
    if keys is not None and keys.size and keys.dtype.kind == "i":
        last = _key_scans(arrays) - 1
        own = keys.reshape(-1)
        joined = arrays.get("state.closure_state.joined", np.array(-1)).reshape(-1)[0] >= 0
        counted = own[0] == 0 and (own[-1] < last if joined else own[-1] == last)
        if not counted or not np.isin(np.diff(own), (0, 1)).all():
            raise ArgumentError("trajectory.keys", f"key scans 0 to {last}, in order", keys)
    stored = arrays.get("state.closure_state.scans.keys")
    if stored is not None and stored.dtype.kind == "i" and (np.diff(stored.reshape(-1)) <= 0).any():
        raise ArgumentError("state.closure_state.scans.keys", "scans in order", stored)
