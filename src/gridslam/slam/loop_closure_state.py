"""What loop closure remembers of a run."""

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
from gridslam.slam.constraints import Constraint, constraints_from_arrays, constraints_to_arrays
from gridslam.slam.graph_slam import GraphSolution
from gridslam.slam.incremental import Computation
from gridslam.slam.key_graph import KeyGraph
from gridslam.slam.scan_archive import ScanArchive
from gridslam.slam.submaps import SubmapCache
from gridslam.types import FloatArray

__all__ = ["Correction", "LoopClosureState", "PendingConstraints", "RejectionReason"]


class RejectionReason(Enum):
    """Why a recognized place was not believed."""

    POOR = "too few beams agree"
    AMBIGUOUS = "another place fits as well"
    UNDETERMINED = "a direction is left open"
    THROUGH_WALLS = "beams would pass through walls"
    IMPLAUSIBLE = "too far from where the robot can be"
    INCONSISTENT = "the scans after it say otherwise"


@final
@dataclass(slots=True, eq=False)
class Correction:
    """A corrected past that is being drawn: poses of the key scans, and the map of the first `drawn` of them."""

    poses: FloatArray
    maps: TileMaps
    drawn: int = 0


@final
@dataclass(slots=True, eq=False)
class PendingConstraints:
    """New ties that the graph is being solved with.

    Attributes
    ----------
    keys, ties : int
        The graph is that of the first so many key scans and ties.
    new : int
        The last so many of these ties are in question.
    steps : int
        Steps of work done.
    work : Computation of GraphSolution or None
        What does them; None where it has to be begun again, up to `steps`.
    """

    keys: int
    ties: int
    new: int
    steps: int = 0
    work: Computation[GraphSolution] | None = None


@final
@dataclass(slots=True, eq=False)
class LoopClosureState:
    """What loop closure remembers of a run.

    Attributes
    ----------
    scans : ScanArchive
        All scans.
    graph : KeyGraph
        The key scans and how they hang together.
    hypotheses : list of Constraint
        Places recognized lately that wait for others to agree.
    rejected : Counter
        How often which reason spoke against a place.
    said : list of (3,) float64
        The best particle's pose at each key scan, as told at the time or corrected since.
    doubts : (float, float), m^2, rad^2
        Variances of the odometry that the tracker took instead of a match, up to the newest key scan.
    failures, next_search : int
        Searches in a row that found nothing, and the key scan at which to search next.
    area, wide : tuple of int
        Submaps in which was searched last, and from which the place found there must be told; while they are the ones
        to search in, their map is drawn once.
    weighing : PendingConstraints or None
        Places just recognized, of which is not known yet what the graph says.
    correction : Correction or None
        A corrected past on its way into the filter.
    """

    scans: ScanArchive = field(default_factory=ScanArchive)
    graph: KeyGraph = field(default_factory=KeyGraph)
    hypotheses: list[Constraint] = field(default_factory=list)
    rejected: Counter[RejectionReason] = field(default_factory=Counter)
    correction: Correction | None = None
    said: list[FloatArray] = field(default_factory=list)
    doubts: tuple[float, float] = (0.0, 0.0)
    failures: int = 0
    next_search: int = 0
    area: tuple[int, ...] = ()
    wide: tuple[int, ...] = ()
    weighing: PendingConstraints | None = None
    submaps: SubmapCache = field(default_factory=SubmapCache)

    def correct(self, poses: FloatArray) -> None:
        """Let the key scans be at poses (T, 3): what was drawn from others is drawn anew."""
        self.graph.correct(poses)
        self.area = self.wide = ()
        self.submaps.forget()

    def snapshot(self) -> LoopClosureState:
        """Keep a copy for later; scans are shared, and what is kept only for speed is not copied."""
        pending = self.correction
        if pending is not None:
            pending = replace(pending, maps=pending.maps.snapshot())
        return LoopClosureState(
            self.scans.snapshot(), self.graph.snapshot(), self.hypotheses.copy(), self.rejected.copy(), pending,
            self.said.copy(), self.doubts, self.failures, self.next_search, self.area, self.wide,
            None if self.weighing is None else replace(self.weighing, work=None),
        )  # fmt: skip

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Plain arrays; `from_arrays` continues to the same bytes."""
        arrays: dict[str, NDArray[Any]] = {
            "said": np.array(self.said, np.float64).reshape(-1, 3),
            "doubts": np.array(self.doubts),
            "search": np.array([self.failures, self.next_search, *self.area], np.int64),
            "wide": np.array(self.wide, np.int64),
            "rejected": np.array([self.rejected[reason] for reason in RejectionReason], np.int64),
        }
        parts: list[tuple[str, dict[str, NDArray[Any]]]] = [
            ("hypotheses", constraints_to_arrays(self.hypotheses)),
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
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], mapper: OccupancyGridMapping, threads: int = 1
    ) -> LoopClosureState:
        """Rebuild from `to_arrays`; raises KeyError where an array is missing."""

        def part(prefix: str) -> dict[str, NDArray[Any]]:
            return {name[len(prefix) + 1 :]: a for name, a in arrays.items() if name.startswith(prefix + ".")}

        counts = zip(RejectionReason, arrays["rejected"].tolist(), strict=True)
        failures, next_search, *area = arrays["search"].tolist()
        correction = None
        if "correction.drawn" in arrays:
            maps = mapper.restore(part("correction.maps"), threads)
            correction = Correction(arrays["correction.poses"], maps, int(arrays["correction.drawn"]))
        return cls(
            ScanArchive.from_arrays(part("scans")),
            KeyGraph.from_arrays(part("graph")),
            constraints_from_arrays(part("hypotheses")),
            Counter({reason: n for reason, n in counts if n}),
            correction,
            list(arrays["said"]),
            (float(arrays["doubts"][0]), float(arrays["doubts"][1])),
            failures,
            next_search,
            tuple(area),
            tuple(arrays["wide"].tolist()),
            PendingConstraints(*arrays["weighing"].tolist()) if "weighing" in arrays else None,
        )
