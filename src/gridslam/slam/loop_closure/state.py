"""State of loop closure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Annotated, NamedTuple, Protocol, final

import numpy as np

from gridslam.arguments import COUNT, Limits, Size
from gridslam.geometry.single_pose import as_pose, is_within
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.serialization import NOT_SAVED
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.key_graph import KeyGraph
from gridslam.slam.loop_closure.map_piece import MapPiece, PieceMatch
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submap_pairs import SubmapPairs
from gridslam.slam.loop_closure.submaps import draw_submap
from gridslam.slam.pose_graph.descent import Computation
from gridslam.slam.pose_graph.graph_slam import GraphSolution
from gridslam.types import FloatArray


class RejectionReason(Enum):
    """Why a loop-closure candidate was rejected."""

    INCONSISTENT = "too few others agree, or as many contradict"
    IMPLAUSIBLE = "contradicts the graph"


@final
class SubmapPrior(NamedTuple):
    """Where a submap is expected, seen from the middle of an older one, and how far it may be from there.

    Attributes
    ----------
    older : int
        Number of the older one.
    pose : (3,) float64
        The pose that is expected.
    reach_m, reach_rad : float
        What it may be off.
    """

    older: Annotated[int, COUNT]
    pose: Annotated[FloatArray, 3]
    reach_m: float
    reach_rad: float

    def allows(self, pose: FloatArray) -> bool:
        """Whether a pose (3,) is within reach."""
        return is_within(as_pose(pose), as_pose(self.pose), self.reach_m, self.reach_rad)


@final
@dataclass(slots=True, eq=False)
class SubmapSearch:
    """Progress of the comparison of submaps while the robot drives; they are numbered in the order of the way.

    Attributes
    ----------
    first_key : int
        Submaps of key scans before it, of earlier drives, are not compared with each other.
    described, compared : int
        Number of first submaps whose features are known, and of those whose comparison with older ones has begun.
    left : list of SubmapPrior
        Older ones that the last of these is still to be compared with.
    candidates : list of Constraint
        Matches that were verified.
    is_undecided : bool
        Whether some of them were added since it was decided which are accepted.
    unsearched : int
        Number of submaps that were not compared with some older ones that only the drift model allows for, and not the
        bound of the drift.
    """

    first_key: Annotated[int, Limits(0, "T")] = 0
    described: Annotated[int, COUNT] = 0
    compared: Annotated[int, COUNT] = 0
    left: list[SubmapPrior] = field(default_factory=list)
    candidates: list[Constraint] = field(default_factory=list)
    is_undecided: bool = False
    unsearched: Annotated[int, COUNT] = 0

    def snapshot(self) -> SubmapSearch:
        """Return an independent copy."""
        return replace(self, left=self.left.copy(), candidates=self.candidates.copy())

    def truncate(self, submaps: int, key_scans: int) -> None:
        """Forget all but the first submaps and key scans."""
        if self.compared > submaps:
            self.left = []
        self.described = min(self.described, submaps)
        self.compared = min(self.compared, submaps)
        self.candidates = [candidate for candidate in self.candidates if candidate.to < key_scans]
        self.is_undecided = self.is_undecided and bool(self.candidates)


@final
@dataclass(slots=True, eq=False)
class Correction:
    """A corrected trajectory whose map is rebuilt: key scan poses, and the map of the first `inserted` of them."""

    poses: Annotated[FloatArray, "corrected", 3]
    maps: Annotated[TileMaps, 1]
    inserted: Annotated[int, Limits(0, "corrected")] = 0

    def __len__(self) -> int:
        """Return the number of its key scans."""
        return len(self.poses)


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

    keys: Annotated[int, Limits(1, "T")]
    constraints: Annotated[int, Limits(0, "constraints")]
    new: Annotated[int, Limits(0, "constraints")]
    steps: Annotated[int, COUNT] = 0
    computation: Computation[GraphSolution] | None = field(default=None, metadata=NOT_SAVED)


@final
class FoundPiece(NamedTuple):
    """An earlier piece in which a drive was found.

    Attributes
    ----------
    number : int
        Its number among the earlier ones.
    piece : MapPiece
        The piece.
    maps : TileMaps
        One map, drawn from it.
    match : PieceMatch
        Where the drive lies in it.
    """

    number: int
    piece: MapPiece
    maps: TileMaps
    match: PieceMatch


class DriveLocator(Protocol):
    """Locates a drive in the maps of earlier ones."""

    def locate(self, closure_state: LoopClosureState) -> FoundPiece | None:
        """Called at each key scan: the piece in which the drive so far lies, once that is certain."""
        ...


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
    online_poses : list of (3,) float64
        Online pose of the best particle at each key scan, or its later correction.
    search : SubmapSearch
        Progress of place recognition.
    rejected : Counter
        Number of rejected candidates by reason.
    pending_constraints : PendingConstraints or None
        New constraints that the graph solver has not accepted or rejected yet.
    correction : Correction or None
        A corrected trajectory that will replace the filter's.
    earlier : DriveLocator or None
        Where the robot may be found again: what earlier drives have left, until it was found in a piece of it. Not
        saved with the state: whoever restores it gives it again.
    joined : int
        Number of the piece in which it was found; -1 before. Its key scans are then the first ones.
    found_in : MapPiece or None
        That piece; None before. Not saved with the state: who saves it writes down which drives came first.
    joined_after : int
        Number of key scans of the drive after which it was found.
    threads : int
        Of the kernels that match many scans; never changes a result. As the last step had it.
    """

    scans: Annotated[ScanArchive, Size("T", "keys")] = field(default_factory=ScanArchive)
    graph: Annotated[KeyGraph, "T", Size("constraints", "constraints")] = field(default_factory=KeyGraph)
    online_poses: Annotated[list[Annotated[FloatArray, 3]], "T"] = field(default_factory=list)
    search: SubmapSearch = field(default_factory=SubmapSearch)
    rejected: Counter[RejectionReason] = field(default_factory=Counter)
    pending_constraints: PendingConstraints | None = None
    correction: Annotated[Correction, Limits(1, "T")] | None = None
    earlier: DriveLocator | None = field(default=None, metadata=NOT_SAVED)
    joined: Annotated[int, Limits(-1, 1 << 31)] = -1
    joined_after: Annotated[int, Limits(0, "T")] = 0
    found_in: MapPiece | None = field(default=None, metadata=NOT_SAVED)
    threads: int = field(default=1, metadata=NOT_SAVED)
    last_submap: tuple[int, TileMaps] | None = field(default=None, metadata=NOT_SAVED)
    pairs: SubmapPairs = field(default_factory=SubmapPairs, metadata=NOT_SAVED)

    def submap(self, submap: int, mapper: OccupancyGridMapping) -> TileMaps:
        """The map of a submap, in the frame of its anchor; the last one is kept, for the next key scan."""
        if self.last_submap is None or self.last_submap[0] != submap:
            self.last_submap = submap, draw_submap(submap, mapper, self.scans, self.graph)
        return self.last_submap[1]

    def driven_before_found_m(self, first: int) -> float:
        """Metres driven from key scan `first`, the first one of the drive, until it was found in an earlier piece."""
        tracked = np.array(self.graph.tracked[first : first + self.joined_after])
        return float(np.hypot(*np.diff(tracked[:, :2], axis=0).T).sum())

    def reject(self, constraints: Sequence[Constraint], accepted: Sequence[Constraint]) -> None:
        """Forget candidates that the graph contradicts, all but the accepted ones."""
        rejected = {c.identity for c in constraints} - {c.identity for c in accepted}
        self.search.candidates = [c for c in self.search.candidates if c.identity not in rejected]
        self.rejected[RejectionReason.IMPLAUSIBLE] += len(constraints) - len(accepted)

    def join(self, found: FoundPiece) -> LoopClosureState:
        """Give the state of both: an earlier piece in which the drive so far was found, and the drive behind it."""
        whole = found.piece.append(MapPiece(self.scans, self.graph), found.match)
        return LoopClosureState(
            scans=whole.scans,
            graph=whole.graph,
            online_poses=[*whole.poses],
            search=SubmapSearch(first_key=len(found.piece)),
            rejected=self.rejected.copy(),
            joined=found.number,
            joined_after=len(self.graph),
            found_in=found.piece,
            threads=self.threads,
        )

    def truncate(self, scans: int, key_scans: int) -> None:
        """Forget all but the first scans and key scans, wherever a step that added others has ended."""
        if (scans, key_scans) == (len(self.scans), len(self.graph)):
            return
        self.scans.truncate(scans, key_scans)
        self.graph.truncate(key_scans)
        self.online_poses = self.online_poses[:key_scans]
        pending = self.pending_constraints
        if pending is not None:
            pending.computation = None
            is_whole = pending.constraints <= len(self.graph.constraints) and pending.keys <= key_scans
            self.pending_constraints = pending if is_whole else None
        if self.correction is not None:
            self.correction.poses = self.correction.poses[:key_scans]
            self.correction.inserted = min(self.correction.inserted, len(self.correction.poses))
        self.last_submap = None
        submaps = self.pairs.count_within(key_scans)
        if submaps < len(self.pairs.submaps):
            self.pairs = SubmapPairs()
            self.search.truncate(submaps, key_scans)

    def snapshot(self) -> LoopClosureState:
        """Return a copy; scans are shared and caches are not copied."""
        correction = self.correction
        pending = self.pending_constraints
        return replace(
            self,
            scans=self.scans.snapshot(),
            graph=self.graph.snapshot(),
            online_poses=self.online_poses.copy(),
            search=self.search.snapshot(),
            rejected=self.rejected.copy(),
            pending_constraints=None if pending is None else replace(pending, computation=None),
            correction=None if correction is None else replace(correction, maps=correction.maps.snapshot()),
            last_submap=None,
            pairs=self.pairs.copy(),
        )
