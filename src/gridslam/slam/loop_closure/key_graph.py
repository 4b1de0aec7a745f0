"""The pose graph of a run: key scans in submaps, odometry constraints and loop-closure constraints."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, final

import numpy as np

from gridslam.arguments import Limits
from gridslam.geometry.se2 import between, compose
from gridslam.geometry.single_pose import UNKNOWN_POSE, Pose
from gridslam.serialization import NOT_SAVED
from gridslam.slam.loop_closure.certain_ways import follow_certain_ways
from gridslam.slam.loop_closure.constraints import Constraint, key_scan_pairs
from gridslam.slam.loop_closure.drift_model import (
    compute_moments,
    compute_moments_of_variances,
    position_variances,
    propagate_covariances,
)
from gridslam.slam.pose_graph.linear import find_parts
from gridslam.slam.pose_graph.pose_graph import PoseGraph
from gridslam.types import FloatArray, IntArray

KEY_SCANS_PER_SUBMAP = 10
"""Key scans of a submap: about 5 m of driving."""

BLIND_SIGMA_M = 0.5
BLIND_SIGMA_RAD = 0.1
"""Standard deviations above which an increment is regarded as a gap."""

UNKNOWN_VARIANCES = (1e6, math.pi**2)
"""Variances (m^2, rad^2) of the increment from the last key scan of a drive to the first one of the next: none is known
of it."""

_MATCH_RATIO = 1 / 6
"""Standard deviation that is expected of a constraint over the one that it has in searches and against outliers: 0.05 m
for a beam over that of `PlaceMatching`."""

_COLUMNS = 20
"""Columns of the running sums: metres driven, as tracked; gaps in the laser data; nine moments of the variances;
nine moments of the drift from key scan 0, as tracked."""


def submap_of(key: int) -> int:
    """Index of the submap that a key scan belongs to."""
    return key // KEY_SCANS_PER_SUBMAP


def anchor_of(submap: int) -> int:
    """The key scan in whose frame a submap is."""
    return submap * KEY_SCANS_PER_SUBMAP + KEY_SCANS_PER_SUBMAP // 2


def position_sigmas(covariances: FloatArray) -> FloatArray:
    """Greatest standard deviations (K,) of the position, of covariances (K, 3, 3)."""
    xx, xy, yy = covariances[:, [0, 0, 1], [0, 1, 1]].T
    return np.asarray(np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)), np.float64)


@final
@dataclass(slots=True, eq=False)
class KeyGraph:
    """Key scans 0 .. T - 1, the constraints between them, and the uncertainty of relative poses.

    Uncertainty between two key scans is that of the best known way through the graph (the least uncertain path), an
    upper bound of what all ways together would leave. Heading errors are kept with where they happened, so that the
    bound has the shape of a drift: long across the way, short along it.

    Attributes
    ----------
    tracked : list of (3,) float64
        Poses in the tracker's frame.
    odometry : list of (3,) float64
        Poses by the odometry as it is, in a frame of its own in each drive; NaN without.
    poses : list of (3,) float64
        Poses in the map frame: as solved last, and as tracked since.
    variances : list of (float, float), m^2 and rad^2
        Of the increment that leads to each key scan, generous bounds for searches.
    covariances : list of (3, 3) float64
        Expected covariance of the same increment as tracked, in the frame of that key scan.
    drift_covariances : list of (3, 3) float64
        Expected covariance of what the filter drifted by since the key scan before, in the same frame.
    constraints : list of Constraint
        Matches of key scans to older submaps.
    frozen : int
        Number of first key scans that are frozen: their poses stay as they are, whatever is found out later.

    References
    ----------
    Olson, Robust and efficient robotic mapping, 2008 (Dijkstra projection).
    """

    tracked: Annotated[list[Annotated[FloatArray, 3]], "T"] = field(default_factory=list)
    odometry: Annotated[list[Annotated[FloatArray, 3]], "T"] = field(default_factory=list)
    poses: Annotated[list[Annotated[FloatArray, 3]], "T"] = field(default_factory=list)
    variances: Annotated[list[tuple[float, float]], "T"] = field(default_factory=list)
    covariances: Annotated[list[Annotated[FloatArray, 3, 3]], "T"] = field(default_factory=list)
    drift_covariances: Annotated[list[Annotated[FloatArray, 3, 3]], "T"] = field(default_factory=list)
    constraints: list[Constraint] = field(default_factory=list)
    frozen: Annotated[int, Limits(0, "T")] = 0
    # (T, 20) float64, running sums up to each key scan
    _sums: bytearray = field(init=False, default_factory=bytearray, metadata=NOT_SAVED)
    # key scans to which the most certain known way comes by a constraint
    _arrivals: list[int] = field(init=False, default_factory=list, metadata=NOT_SAVED)
    # (9,) each, what those ways change of the drift: before the first arrival, from each one to the next
    _gains: list[FloatArray] = field(init=False, default_factory=lambda: [np.zeros(9)], metadata=NOT_SAVED)
    # determined constraints, by which ways lead, and (L, 11) float64, their key scans and moments
    _links: list[Constraint] = field(init=False, default_factory=list, metadata=NOT_SAVED)
    _link_rows: bytearray = field(init=False, default_factory=bytearray, metadata=NOT_SAVED)

    def __post_init__(self) -> None:
        """Derive the moments."""
        if self.poses:
            self.correct(np.array(self.poses))

    def __len__(self) -> int:
        """Return the number of key scans."""
        return len(self.poses)

    @property
    def drift(self) -> FloatArray:
        """Moments (9,) of the newest key scan's pose as seen from the first, along the most certain known way."""
        return self._drift_at(len(self) - 1)

    def driven_m(self) -> FloatArray:
        """Metres driven (T,) up to each key scan, as tracked."""
        return _rows(self._sums, _COLUMNS)[:, 0].copy()

    def begins_drive(self, key: int) -> bool:
        """Whether a key scan is the first one of a drive that was joined with earlier ones."""
        return key > 0 and self.variances[key][0] >= UNKNOWN_VARIANCES[0]

    def extend(
        self,
        tracked: FloatArray,
        pose: FloatArray,
        variances: tuple[float, float],
        covariance: FloatArray | None = None,
        drift_covariance: FloatArray | None = None,
        odometry: Pose | FloatArray = UNKNOWN_POSE,
    ) -> None:
        """Add a key scan: the tracker's pose (3,), the pose (3,) in the map, the variances of the increment.

        The expected covariance (3, 3) is that of the variances if not given, and that of the drift the same.
        """
        self.tracked.append(tracked)
        self.odometry.append(np.array(odometry))
        self.poses.append(pose)
        self.variances.append(variances)
        expected = np.diag(np.take(variances, [0, 0, 1])) if covariance is None else covariance
        self.covariances.append(expected)
        self.drift_covariances.append(expected if drift_covariance is None else drift_covariance)
        self._derive()

    def add(self, constraint: Constraint) -> None:
        """Add a measurement between two key scans."""
        self.constraints.append(constraint)
        self._use([constraint])

    def append(self, later: KeyGraph, poses: FloatArray, variances: tuple[float, float]) -> None:
        """Append the key scans of another graph, at `poses` (K, 3) in this one's map, and its constraints.

        `variances` (m^2, rad^2) are those of the increment from the last key scan of this graph to the first one of the
        other. The tracker's frame becomes that of the other graph, whose robot drives on. What is frozen of this one
        stays so, what is of the other one moves here.
        """
        first = len(self)
        last = compose(later.tracked[0], between(poses[0], self.poses[-1]))
        self.tracked = [*compose(last, between(self.tracked[-1], np.array(self.tracked))), *later.tracked]
        unknown = np.diag(np.take(variances, [0, 0, 1]))
        self.odometry += later.odometry
        self.variances += [variances, *later.variances[1:]]
        self.covariances += [unknown, *later.covariances[1:]]
        self.drift_covariances += [unknown, *later.drift_covariances[1:]]
        self.constraints += [
            constraint._replace(from_=first + constraint.from_, to=first + constraint.to)
            for constraint in later.constraints
        ]
        self.correct(np.concatenate([np.array(self.poses), poses]))

    def truncate(self, keys: int) -> None:
        """Forget all but the first key scans, and the constraints of the others."""
        increments = self.variances, self.covariances, self.drift_covariances
        for own in (self.tracked, self.odometry, self.poses, *increments):
            del own[keys:]
        self.constraints = [constraint for constraint in self.constraints if constraint.to < keys]
        self.frozen = min(self.frozen, keys)
        self.correct(np.array(self.poses))

    def correct(self, poses: FloatArray) -> None:
        """Set all poses (T, 3)."""
        self.poses = list(poses)
        for derived in (self._sums, self._links, self._link_rows, self._arrivals):
            derived.clear()
        del self._gains[1:]
        self._derive()
        self._use(self.constraints)

    def extend_with_tracked(self, poses: FloatArray) -> FloatArray:
        """Poses (T, 3) of all key scans: the first ones as given, (K, 3), the rest as tracked from there."""
        last = len(poses) - 1
        return np.concatenate(
            [poses, compose(poses[-1], self.tracked_poses_from(last, np.arange(last + 1, len(self))))]
        )

    def tracked_poses_from(self, anchor: int, keys: IntArray) -> FloatArray:
        """Poses (K, 3) of key scans seen from `anchor`, as tracked."""
        return between(self.tracked[anchor], np.array([self.tracked[key] for key in keys.tolist()]).reshape(-1, 3))

    def relative_pose(self, anchor: int, key: int) -> FloatArray:
        """Pose (3,) of a key scan seen from another: as tracked where they are near in time, else as the map has it."""
        frame = self.tracked if abs(anchor - key) <= 3 * KEY_SCANS_PER_SUBMAP else self.poses
        return between(frame[anchor], frame[key])

    def locate(self, key: int, anchors: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return poses (A, 3) of a key scan seen from others (A,), and covariances (A, 3, 3), by the most certain ways.

        They lead along the increments and by determined constraints. Covariances are in the map frame, and those of
        the drift model's bounds.
        """
        sums, of_links = _rows(self._sums, _COLUMNS)[:, 2:11], _rows(self._link_rows, 11)
        ends, moments = follow_certain_ways(
            key,
            self.poses[key],
            anchors,
            self.tracked,
            sums,
            self._links,
            of_links[:, :2].astype(np.int64),
            of_links[:, 2:],
        )
        poses = between(np.array([self.tracked[anchor] for anchor in anchors.tolist()]), ends)
        return poses, propagate_covariances(self.poses[key], moments)

    def label_gaps(self) -> IntArray:
        """Label (T,) of the stretch without a gap in the laser data that each key scan belongs to, ascending."""
        return _rows(self._sums, _COLUMNS)[:, 1].astype(np.int64)

    def label_rigid_components(self, constraints: Sequence[Constraint] | None = None) -> IntArray:
        """Label (T,) of the rigid component of each key scan, from 0 on in the order of their first ones.

        Components are separated by gaps in the laser data, and joined by tracked or recognized constraints and by those
        added by hand: by those of the graph, if no others are given.
        """
        stretches = self.label_gaps()
        if not stretches[-1]:
            return stretches  # nearly always, and each search for places asks
        known = self.constraints if constraints is None else constraints
        joined = stretches[key_scan_pairs(constraint for constraint in known if constraint.is_certain)]
        return find_parts(joined, int(stretches[-1]) + 1).take(stretches)

    def select_without_gap(self, keys: IntArray, anchor: int) -> IntArray:
        """Select those of consecutive key scans (K,) that no gap separates from `anchor`."""
        labels = self.label_gaps()
        return np.asarray(keys[labels[keys] == labels[anchor]], np.int64)

    def graph(
        self, increments: FloatArray | None = None, keys: int | None = None, constraints: int | None = None
    ) -> PoseGraph:
        """Everything as a pose graph: increments (T - 1, 3), then the loop-closure constraints.

        The increments are trusted; they are the tracked ones if not given. `keys` and `constraints` limit the graph to
        the first of each.
        What is frozen is held, else the first pose alone.
        """
        poses = np.array(self.poses[:keys])
        tracked = np.array(self.tracked[:keys])
        count = len(poses)
        known = self.constraints[:constraints]
        steps = np.zeros((count - 1, 3, 3))
        steps[:, [0, 1, 2], [0, 1, 2]] = 1 / np.array(self.variances[1:count]).reshape(-1, 2)[:, [0, 0, 1]]
        chain = np.stack([np.arange(count - 1), np.arange(1, count)], axis=1)
        measurements = np.array([t.measurement for t in known]).reshape(-1, 3)
        return PoseGraph(
            poses,
            np.concatenate([chain, key_scan_pairs(known)]),
            np.concatenate([between(tracked[:-1], tracked[1:]) if increments is None else increments, measurements]),
            np.concatenate([steps, np.array([t.information for t in known]).reshape(-1, 3, 3)]),
            np.arange(count - 1 + len(known)) < count - 1,
            min(max(self.frozen, 1), count),
        )

    def select(self, keys: IntArray) -> KeyGraph:
        """Return the graph of the key scans (K,) of some of the drives, at the same poses."""
        number = {key: place for place, key in enumerate(keys.tolist())}
        increments = [0, *keys[1:].tolist()]  # none leads to the first one
        return KeyGraph(
            tracked=[self.tracked[key] for key in number],
            odometry=[self.odometry[key] for key in number],
            poses=[self.poses[key] for key in number],
            variances=[self.variances[key] for key in increments],
            covariances=[self.covariances[key] for key in increments],
            drift_covariances=[self.drift_covariances[key] for key in increments],
            constraints=[
                c._replace(from_=number[c.from_], to=number[c.to])
                for c in self.constraints
                if c.from_ in number and c.to in number
            ],
            frozen=int(np.searchsorted(keys, self.frozen)),
        )

    def snapshot(self) -> KeyGraph:
        """Return a copy for later; arrays that never change are shared."""
        twin = KeyGraph()
        for own in fields(self):
            value = getattr(self, own.name)
            setattr(twin, own.name, value if isinstance(value, int | None) else value.copy())
        return twin

    def _derive(self) -> None:
        """Extend the values derived from poses and variances to the newest key scan."""
        first = len(_rows(self._sums, _COLUMNS))
        poses = np.array(self.poses[first:])
        variances = np.array(self.variances[first:])
        tracked = np.array([self.tracked[max(first - 1, 0)], *self.tracked[first:]])
        driven_m = np.hypot(*(tracked[1:, :2] - tracked[:-1, :2]).T)[:, None]
        is_gap = (variances > np.square([BLIND_SIGMA_M, BLIND_SIGMA_RAD])).any(axis=1, keepdims=True)
        bounds = compute_moments_of_variances(poses, variances)
        drifts = compute_moments(poses, np.array(self.drift_covariances[first:]))
        added = np.concatenate([driven_m, is_gap, bounds, drifts], axis=1)
        if first:
            added[0] += _rows(self._sums, _COLUMNS)[-1]
        else:
            added[0, 11:] = 0.0  # the first pose is the origin
        self._sums += added.cumsum(axis=0).tobytes()

    def _use(self, constraints: Sequence[Constraint]) -> None:
        """Let constraints lead from one key scan to another, and shorten the ways from the first key scan.

        In the order in which they were found, one by one: a graph that was saved goes on to the last bit.
        """
        determined = [constraint for constraint in constraints if constraint.determined]
        if not determined:
            return
        covariances = np.asarray(np.linalg.inv(np.array([c.information for c in determined])), np.float64)
        of_links = compute_moments(np.array([self.poses[c.to] for c in determined]), covariances)
        self._links += determined
        self._link_rows += np.column_stack([key_scan_pairs(determined), of_links]).tobytes()
        for constraint, moments in zip(determined, of_links, strict=True):
            self._shorten_ways(constraint, moments)

    def _drift_at(self, key: int) -> FloatArray:
        """Moments (9,) of the drift from key scan 0 to another, along the most certain known way."""
        return _rows(self._sums, _COLUMNS)[key, 11:] + self._gains[bisect_right(self._arrivals, key)]

    def _shorten_ways(self, constraint: Constraint, moments: FloatArray) -> None:
        """Let the way to a key scan and to those after it come by a constraint if it is more certain so."""
        at = constraint.to
        gained = self._drift_at(constraint.from_) + _MATCH_RATIO**2 * moments - self._drift_at(at)
        if position_variances(self.poses[at], gained) >= 0:
            return
        later = bisect_right(self._arrivals, at)
        gain = self._gains[later] + gained
        if later and self._arrivals[later - 1] == at:
            self._gains[later] = gain
        else:
            self._arrivals.insert(later, at)
            self._gains.insert(later + 1, gain)


def _rows(stored: bytearray, columns: int) -> FloatArray:
    """View stored rows (K, C) of float64; none can be added while there is a view."""
    return np.frombuffer(stored).reshape(-1, columns)
