"""State of loop closure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.loop_closure.constraints import Constraint, constraints_from_arrays, constraints_to_arrays
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submaps import SubmapCache
from gridslam.slam.pose_graph.graph_slam import GraphSolution
from gridslam.slam.pose_graph.incremental import Computation
from gridslam.types import FloatArray

__all__ = ["Correction", "LoopClosureState", "PendingConstraints", "RejectionReason"]


class RejectionReason(Enum):
    """Why a loop-closure candidate was rejected."""

    LOW_INLIER_RATIO = "low inlier ratio"
    AMBIGUOUS = "ambiguous: another place fits as well"
    DEGENERATE = "degenerate direction"
    THROUGH_WALLS = "beams would pass through walls"
    IMPLAUSIBLE = "outside the pose uncertainty"
    INCONSISTENT = "inconsistent with the next scans"


@final
@dataclass(slots=True, eq=False)
class Correction:
    """A corrected trajectory whose map is rebuilt: key scan poses, and the map of the first `inserted` of them."""

    poses: FloatArray
    maps: TileMaps
    inserted: int = 0


@final
@dataclass(slots=True, eq=False)
class PendingConstraints:
    """New constraints, while the graph is solved with them.

    Attributes
    ----------
    keys, constraints : int
        Number of key scans and constraints in the graph being solved.
    new : int
        Number of new constraints, the last of `constraints`.
    steps : int
        Steps of work done.
    computation : Computation of GraphSolution or None
        The running computation; None if it must be restarted and advanced to `steps`.
    """

    keys: int
    constraints: int
    new: int
    steps: int = 0
    computation: Computation[GraphSolution] | None = None


@final
@dataclass(slots=True, eq=False)
class LoopClosureState:
    """State of loop closure.

    Attributes
    ----------
    scans : ScanArchive
        All scans.
    graph : KeyGraph
        Key scans, odometry and loop-closure constraints.
    unconfirmed : list of Constraint
        Recent loop-closure candidates that are not confirmed yet.
    rejected : Counter
        Number of rejected candidates by reason.
    online_poses : list of (3,) float64
        Online pose of the best particle at each key scan, or its later correction.
    rejected_match_variances : (float, float), m^2, rad^2
        Accumulated variances of the odometry increments used in place of a rejected scan match, up to the newest key
        scan.
    failed_searches, next_search : int
        Number of consecutive failed searches, and the key scan of the next search.
    search_submaps, ambiguity_submaps : tuple of int
        Submaps of the last search, and those of its ambiguity check; their joint maps are cached while they do not
        change.
    pending_constraints : PendingConstraints or None
        New constraints that the graph solver has not accepted or rejected yet.
    correction : Correction or None
        A corrected trajectory that will replace the filter's.
    """

    scans: ScanArchive = field(default_factory=ScanArchive)
    graph: KeyGraph = field(default_factory=KeyGraph)
    unconfirmed: list[Constraint] = field(default_factory=list)
    rejected: Counter[RejectionReason] = field(default_factory=Counter)
    correction: Correction | None = None
    online_poses: list[FloatArray] = field(default_factory=list)
    rejected_match_variances: tuple[float, float] = (0.0, 0.0)
    failed_searches: int = 0
    next_search: int = 0
    search_submaps: tuple[int, ...] = ()
    ambiguity_submaps: tuple[int, ...] = ()
    pending_constraints: PendingConstraints | None = None
    submap_cache: SubmapCache = field(default_factory=SubmapCache)

    def correct(self, poses: FloatArray) -> None:
        """Set the poses (T, 3) of the key scans and invalidate cached maps."""
        self.graph.correct(poses)
        self.search_submaps = self.ambiguity_submaps = ()
        self.submap_cache.forget()

    def snapshot(self) -> LoopClosureState:
        """Return a copy; scans are shared and caches are not copied."""
        pending = self.correction
        if pending is not None:
            pending = replace(pending, maps=pending.maps.snapshot())
        return LoopClosureState(
            self.scans.snapshot(), self.graph.snapshot(), self.unconfirmed.copy(), self.rejected.copy(), pending,
            self.online_poses.copy(), self.rejected_match_variances, self.failed_searches, self.next_search,
            self.search_submaps, self.ambiguity_submaps,
            None if self.pending_constraints is None else replace(self.pending_constraints, computation=None),
        )  # fmt: skip

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays; `from_arrays` continues with identical results."""
        arrays: dict[str, NDArray[Any]] = {
            "online_poses": np.array(self.online_poses, np.float64).reshape(-1, 3),
            "rejected_match_variances": np.array(self.rejected_match_variances),
            "search": np.array([self.failed_searches, self.next_search, *self.search_submaps], np.int64),
            "ambiguity_submaps": np.array(self.ambiguity_submaps, np.int64),
            "rejected": np.array([self.rejected[reason] for reason in RejectionReason], np.int64),
        }
        parts: list[tuple[str, dict[str, NDArray[Any]]]] = [
            ("unconfirmed", constraints_to_arrays(self.unconfirmed)),
            ("scans", self.scans.to_arrays()),
            ("graph", self.graph.to_arrays()),
        ]  # fmt: skip
        if (pending := self.pending_constraints) is not None:
            counts = [pending.keys, pending.constraints, pending.new, pending.steps]
            arrays["pending_constraints"] = np.array(counts, np.int64)
        if self.correction is not None:
            arrays["correction.poses"] = self.correction.poses
            arrays["correction.inserted"] = np.array(self.correction.inserted, np.int64)
            parts.append(("correction.maps", self.correction.maps.to_arrays()))
        return arrays | {f"{name}.{key}": array for name, part in parts for key, array in part.items()}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], mapper: OccupancyGridMapping, threads: int = 1
    ) -> LoopClosureState:
        """Rebuild from `to_arrays`; raises KeyError where an array is missing."""

        def part(prefix: str) -> dict[str, NDArray[Any]]:
            return {name[len(prefix) + 1 :]: a for name, a in arrays.items() if name.startswith(prefix + ".")}

        counts = zip(RejectionReason, arrays["rejected"].tolist(), strict=True)
        failed_searches, next_search, *search_submaps = arrays["search"].tolist()
        correction = None
        if "correction.inserted" in arrays:
            maps = mapper.restore(part("correction.maps"), threads)
            correction = Correction(arrays["correction.poses"], maps, int(arrays["correction.inserted"]))
        return cls(
            ScanArchive.from_arrays(part("scans")),
            KeyGraph.from_arrays(part("graph")),
            constraints_from_arrays(part("unconfirmed")),
            Counter({reason: n for reason, n in counts if n}),
            correction,
            list(arrays["online_poses"]),
            (float(arrays["rejected_match_variances"][0]), float(arrays["rejected_match_variances"][1])),
            failed_searches,
            next_search,
            tuple(search_submaps),
            tuple(arrays["ambiguity_submaps"].tolist()),
            PendingConstraints(*arrays["pending_constraints"].tolist()) if "pending_constraints" in arrays else None,
        )
