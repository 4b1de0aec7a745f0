"""The state of grid-based FastSLAM: explicit, with one owner, and with one versioned schema."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ArgumentError, ConsumedStateError
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.particles.ancestry import Ancestry
from gridslam.slam.loop_closure.state import LoopClosureState
from gridslam.slam.tracking.tracker import TrackerState
from gridslam.types import FloatArray, IntArray, describe_pose

__all__ = ["STATE_SCHEMA", "GridFastSlamState"]

STATE_SCHEMA = "gridslam.state/7"


@final
@dataclass(slots=True, eq=False)
class GridFastSlamState:
    """Everything that the filter knows between two scans; arrays in it are replaced, never written to.

    Attributes
    ----------
    tracker : TrackerState
        The tracker's local maps and pose.
    key_pose : (3,) float64
        The tracker's pose at the last key scan.
    sensor_key_poses : dict of str to (3,) float64
        The tracker's pose at the last key scan of each laser; replaced, never written to.
    poses : (N, 3) float64
        The particles at the last key scan, map frame.
    log_weights : (N,) float64, nats
        Normalized.
    log_ancestry : (N,) float64, nats
        Log weight of each particle accumulated along its ancestry, relative to the greatest.
    covariance : (3, 3) float64
        Of the best particle's pose at the last key scan.
    maps : TileMaps
        One map for each particle.
    ancestry : Ancestry
        All particles' trajectories over the key scans.
    lost : bool
        Whether the last key scan agreed with the best map too little.
    closure_state : LoopClosureState or None
        What loop closure remembers, where it is at work.
    odometry_covariance : (3, 3) float64 or None
        Reported noise of the odometry since its last accepted pose (see `OdometryNoise`).
    """

    tracker: TrackerState
    key_pose: FloatArray
    sensor_key_poses: dict[str, FloatArray]
    poses: FloatArray
    log_weights: FloatArray
    log_ancestry: FloatArray
    covariance: FloatArray
    maps: TileMaps
    ancestry: Ancestry
    lost: bool = False
    closure_state: LoopClosureState | None = None
    odometry_covariance: FloatArray | None = None
    consumed: bool = False

    def __repr__(self) -> str:
        """Return one line."""
        if self.consumed:
            return "GridFastSlamState(consumed)"
        best, lost = describe_pose(self.poses[self.best]), ", lost" if self.lost else ""
        return f"GridFastSlamState({len(self.poses)} particles, the best at {best}{lost})"

    @property
    def best(self) -> int:
        """Index of the particle of greatest log weight accumulated along its ancestry."""
        return int(self.log_ancestry.argmax())

    def take(self) -> GridFastSlamState:
        """Hand the contents over to a new owner; this one raises ConsumedStateError from now on."""
        self._check()
        self.consumed = True
        return GridFastSlamState(
            self.tracker, self.key_pose, self.sensor_key_poses, self.poses, self.log_weights, self.log_ancestry,
            self.covariance, self.maps, self.ancestry, self.lost, self.closure_state, self.odometry_covariance,
        )  # fmt: skip

    def move(self, poses: FloatArray, key_pose: FloatArray, sensor: str) -> None:
        """Move the particles to `poses` (N, 3); `key_pose` (3,) is the tracker's, at a key scan of `sensor`."""
        self.poses = poses
        self.ancestry.extend(poses)
        self.key_pose = key_pose
        self.sensor_key_poses = {**self.sensor_key_poses, sensor: key_pose}

    def resample(self, parents: IntArray) -> None:
        """Let particle i continue particle parents[i], all with equal weights."""
        self.poses = self.poses[parents]
        self.maps.select(parents)
        self.ancestry.resample(parents)
        self.log_ancestry = self.log_ancestry[parents]
        self.log_weights = np.full(len(parents), -np.log(len(parents)))

    def keep_best(self) -> None:
        """Let the best particle be the only one, and give back the memory of the others' maps and of all caches."""
        self.resample(np.array([self.best]))
        self.maps.compact()
        self.closure_state = None if self.closure_state is None else self.closure_state.snapshot()

    def replace_trajectory(self, trajectory: FloatArray, maps: TileMaps) -> None:
        """Let all particles share one past, poses (T, 3), and the first of `maps`, with equal weights."""
        count = len(self.poses)
        self.poses = np.repeat(trajectory[-1:], count, axis=0)
        self.maps, self.ancestry = maps.snapshot(np.zeros(count, np.int64)), Ancestry.from_trajectory(trajectory, count)
        self.log_weights, self.log_ancestry = np.full(count, -np.log(count)), np.zeros(count)

    def snapshot(self) -> GridFastSlamState:
        """Keep this state for later, at the cost of its tables: maps are copied only where either side writes."""
        self._check()
        return replace(
            self,
            tracker=self.tracker.snapshot(),
            maps=self.maps.snapshot(),
            ancestry=self.ancestry.snapshot(),
            closure_state=None if self.closure_state is None else self.closure_state.snapshot(),
        )

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays under the schema `STATE_SCHEMA`; `from_arrays` continues with identical results."""
        self._check()
        own = {name: getattr(self, name) for name in _ARRAYS}
        own["sensor_key_poses"] = np.array(list(self.sensor_key_poses.values()))
        if self.odometry_covariance is not None:
            own["odometry_covariance"] = self.odometry_covariance
        own["sensors"] = np.array(list(self.sensor_key_poses), np.str_)
        parts = [("tracker", self.tracker.to_arrays()), ("maps", self.maps.to_arrays())]
        parts.append(("ancestry", self.ancestry.to_arrays()))
        if self.closure_state is not None:
            parts.append(("closure_state", self.closure_state.to_arrays()))
        nested = {f"{name}.{key}": array for name, arrays in parts for key, array in arrays.items()}
        return {"schema": np.array(STATE_SCHEMA), "lost": np.array(self.lost), **own, **nested}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], mapper: OccupancyGridMapping, threads: int = 1
    ) -> GridFastSlamState:
        """Rebuild the state of a filter with this mapper; ArgumentError for a wrong schema or a missing array."""
        schema = str(arrays.get("schema", "none"))
        if schema != STATE_SCHEMA:
            raise ArgumentError("arrays", f"a state of schema {STATE_SCHEMA}", schema)

        def part(prefix: str) -> dict[str, NDArray[Any]]:
            return {name[len(prefix) + 1 :]: a for name, a in arrays.items() if name.startswith(prefix + ".")}

        try:
            own: dict[str, Any] = {name: np.array(arrays[name], np.float64) for name in _ARRAYS}
            own["odometry_covariance"] = arrays.get("odometry_covariance")
            closure_state = part("closure_state")
            return cls(
                tracker=TrackerState.from_arrays(part("tracker"), mapper),
                sensor_key_poses=dict(zip(arrays["sensors"].tolist(), arrays["sensor_key_poses"], strict=True)),
                maps=mapper.restore(part("maps"), threads),
                ancestry=Ancestry.from_arrays(part("ancestry")),
                lost=bool(arrays["lost"]),
                closure_state=LoopClosureState.from_arrays(closure_state, mapper, threads) if closure_state else None,
                **own,
            )
        except KeyError as missing:
            raise ArgumentError("arrays", f"an array {missing}", "none") from None

    def _check(self) -> None:
        if self.consumed:
            raise ConsumedStateError


_ARRAYS = ("key_pose", "poses", "log_weights", "log_ancestry", "covariance")
