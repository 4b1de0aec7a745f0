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
from gridslam.slam.graph_slam import GraphSolution
from gridslam.slam.key_graph import KeyGraph
from gridslam.slam.scan_archive import ScanArchive
from gridslam.slam.submaps import Submaps
from gridslam.slam.ties import Tie, ties_from_arrays, ties_to_arrays
from gridslam.slam.work import Work
from gridslam.types import FloatArray

__all__ = ["Correction", "Memory", "Rejection", "Weighing"]


class Rejection(Enum):
    """Why a loop-closure candidate was rejected."""

    POOR = "too few beams agree"
    AMBIGUOUS = "another place fits as well"
    UNDETERMINED = "a direction is left open"
    THROUGH_WALLS = "beams would pass through walls"
    IMPLAUSIBLE = "too far from where the robot can be"
    INCONSISTENT = "the scans after it say otherwise"


@final
@dataclass(slots=True, eq=False)
class Correction:
    """A corrected trajectory whose map is being rebuilt: key scan poses, and the map of the first `drawn` of them."""

    poses: FloatArray
    maps: TileMaps
    drawn: int = 0


@final
@dataclass(slots=True, eq=False)
class Weighing:
    """New constraints, while the graph is solved with them.

    Attributes
    ----------
    keys, ties : int
        Number of key scans and constraints in the graph being solved.
    new : int
        Number of new constraints, the last of `ties`.
    steps : int
        Steps of work done.
    work : Work of GraphSolution or None
        The running computation; None if it must be restarted and advanced to `steps`.
    """

    keys: int
    ties: int
    new: int
    steps: int = 0
    work: Work[GraphSolution] | None = None


@final
@dataclass(slots=True, eq=False)
class Memory:
    """State of loop closure.

    Attributes
    ----------
    scans : ScanArchive
        All scans.
    graph : KeyGraph
        Key scans, odometry and loop-closure constraints.
    hypotheses : list of Tie
        Recent loop-closure candidates that are not confirmed yet.
    rejected : Counter
        Number of rejected candidates by reason.
    said : list of (3,) float64
        Online pose of the best particle at each key scan, or its later correction.
    doubts : (float, float), m^2, rad^2
        Accumulated variances of the odometry increments used in place of a rejected scan match, up to the newest key
        scan.
    failures, next_search : int
        Number of consecutive failed searches, and the key scan of the next search.
    area, wide : tuple of int
        Submaps of the last search, and those of its ambiguity check; their joint maps are cached while they do not
        change.
    weighing : Weighing or None
        New constraints that the graph solver has not accepted or rejected yet.
    correction : Correction or None
        A corrected trajectory that will replace the filter's.
    """

    scans: ScanArchive = field(default_factory=ScanArchive)
    graph: KeyGraph = field(default_factory=KeyGraph)
    hypotheses: list[Tie] = field(default_factory=list)
    rejected: Counter[Rejection] = field(default_factory=Counter)
    correction: Correction | None = None
    said: list[FloatArray] = field(default_factory=list)
    doubts: tuple[float, float] = (0.0, 0.0)
    failures: int = 0
    next_search: int = 0
    area: tuple[int, ...] = ()
    wide: tuple[int, ...] = ()
    weighing: Weighing | None = None
    submaps: Submaps = field(default_factory=Submaps)

    def correct(self, poses: FloatArray) -> None:
        """Set the poses (T, 3) of the key scans and invalidate cached maps."""
        self.graph.correct(poses)
        self.area = self.wide = ()
        self.submaps.forget()

    def snapshot(self) -> Memory:
        """Return a copy; scans are shared and caches are not copied."""
        pending = self.correction
        if pending is not None:
            pending = replace(pending, maps=pending.maps.snapshot())
        return Memory(
            self.scans.snapshot(), self.graph.snapshot(), self.hypotheses.copy(), self.rejected.copy(), pending,
            self.said.copy(), self.doubts, self.failures, self.next_search, self.area, self.wide,
            None if self.weighing is None else replace(self.weighing, work=None),
        )  # fmt: skip

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays; `from_arrays` continues with identical results."""
        arrays: dict[str, NDArray[Any]] = {
            "said": np.array(self.said, np.float64).reshape(-1, 3),
            "doubts": np.array(self.doubts),
            "search": np.array([self.failures, self.next_search, *self.area], np.int64),
            "wide": np.array(self.wide, np.int64),
            "rejected": np.array([self.rejected[reason] for reason in Rejection], np.int64),
        }
        parts: list[tuple[str, dict[str, NDArray[Any]]]] = [
            ("hypotheses", ties_to_arrays(self.hypotheses)),
            ("scans", self.scans.to_arrays()),
            ("graph", self.graph.to_arrays()),
        ]  # fmt: skip
        if (weighing := self.weighing) is not None:
            arrays["weighing"] = np.array([weighing.keys, weighing.ties, weighing.new, weighing.steps], np.int64)
        if self.correction is not None:
            arrays["correction.poses"] = self.correction.poses
            arrays["correction.drawn"] = np.array(self.correction.drawn, np.int64)
            parts.append(("correction.maps", self.correction.maps.to_arrays()))
        return arrays | {f"{name}.{key}": array for name, part in parts for key, array in part.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]], mapper: OccupancyGridMapping, threads: int = 1) -> Memory:
        """Rebuild from `to_arrays`; raises KeyError where an array is missing."""

        def part(prefix: str) -> dict[str, NDArray[Any]]:
            return {name[len(prefix) + 1 :]: a for name, a in arrays.items() if name.startswith(prefix + ".")}

        counts = zip(Rejection, arrays["rejected"].tolist(), strict=True)
        failures, next_search, *area = arrays["search"].tolist()
        correction = None
        if "correction.drawn" in arrays:
            maps = mapper.restore(part("correction.maps"), threads)
            correction = Correction(arrays["correction.poses"], maps, int(arrays["correction.drawn"]))
        return cls(
            ScanArchive.from_arrays(part("scans")),
            KeyGraph.from_arrays(part("graph")),
            ties_from_arrays(part("hypotheses")),
            Counter({reason: n for reason, n in counts if n}),
            correction,
            list(arrays["said"]),
            (float(arrays["doubts"][0]), float(arrays["doubts"][1])),
            failures,
            next_search,
            tuple(area),
            tuple(arrays["wide"].tolist()),
            Weighing(*arrays["weighing"].tolist()) if "weighing" in arrays else None,
        )
