"""The pose graph of a run: key scans in submaps, odometry constraints and loop-closure constraints."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Annotated, Any, NamedTuple, final, overload

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import Limits
from gridslam.geometry import single_pose
from gridslam.geometry.se2 import between, compose
from gridslam.geometry.single_pose import ORIGIN, UNKNOWN_POSE, Pose, as_pose
from gridslam.kernels import backend
from gridslam.serialization import NOT_SAVED
from gridslam.slam.loop_closure.constraints import Constraint, ConstraintSource, key_scan_pairs
from gridslam.slam.loop_closure.drift_model import compute_step_moments, propagate_covariances
from gridslam.slam.loop_closure.rows import Rows, new_poses
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

_new_moments = partial(Rows[np.float64], 9, np.float64)
_new_pairs = partial(Rows[np.int32], 2, np.int32)
_new_links = partial(Rows[np.float64], 12, np.float64)


@overload
def submap_of(key: int) -> int: ...
@overload
def submap_of(key: IntArray) -> IntArray: ...
def submap_of(key: Any) -> Any:
    """Index of the submap that a key scan belongs to, or of each."""
    return key // KEY_SCANS_PER_SUBMAP


@overload
def first_key_scan(submap: int) -> int: ...
@overload
def first_key_scan(submap: IntArray) -> IntArray: ...
def first_key_scan(submap: Any) -> Any:
    """Index of the first key scan of a submap, or of each."""
    return submap * KEY_SCANS_PER_SUBMAP


def anchor_of(submap: int) -> int:
    """The key scan in whose frame a submap is."""
    return first_key_scan(submap) + KEY_SCANS_PER_SUBMAP // 2


def position_sigmas(covariances: FloatArray) -> FloatArray:
    """Greatest standard deviations (K,) of the position, of covariances (K, 3, 3)."""
    xx, xy, yy = covariances[:, [0, 0, 1], [0, 1, 1]].T
    return np.asarray(np.sqrt(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)), np.float64)


@final
class SubmapDistance(NamedTuple):
    """A submap with the relative pose of a key scan along the least uncertain path."""

    submap: int
    pose: FloatArray  # (3,)
    covariance: FloatArray  # (3, 3), map frame

    @property
    def sigma_m(self) -> float:
        """Greatest standard deviation of the position."""
        return float(position_sigmas(self.covariance[None])[0])


@final
@dataclass(frozen=True, slots=True, eq=False)
class NearbySubmaps:
    """K submaps with the pose of a key scan relative to each of their first ones, as in `SubmapDistance`.

    Attributes
    ----------
    submaps : (K,) int64
        Nearest first.
    poses, covariances : (K, 3), (K, 3, 3) float64
        Along the least uncertain paths; covariances in the map frame.
    """

    submaps: IntArray
    poses: FloatArray
    covariances: FloatArray

    @property
    def sigmas_m(self) -> FloatArray:
        """Greatest standard deviations of the position, (K,)."""
        return position_sigmas(self.covariances)

    def select(self, chosen: NDArray[np.bool_]) -> NearbySubmaps:
        """Those that are chosen (K,)."""
        return NearbySubmaps(self.submaps[chosen], self.poses[chosen], self.covariances[chosen])

    def __len__(self) -> int:
        """Return the number of submaps."""
        return len(self.submaps)

    def __getitem__(self, k: int) -> SubmapDistance:
        """Submap k of them."""
        return SubmapDistance(int(self.submaps[k]), self.poses[k], self.covariances[k])


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
    # metres driven up to each key scan, as tracked
    _driven_m: list[float] = field(init=False, default_factory=list, metadata=NOT_SAVED)
    # number of gaps in the laser data up to each key scan
    _gap_counts: list[int] = field(init=False, default_factory=list, metadata=NOT_SAVED)
    # (9,) each, moments of the variances up to each key scan
    _sums: list[FloatArray] = field(init=False, default_factory=list, metadata=NOT_SAVED)
    # (9,) each, moments of the drift from key scan 0, as tracked
    _drifts: list[FloatArray] = field(init=False, default_factory=list, metadata=NOT_SAVED)
    # key scans to which the most certain known way comes by a constraint
    _arrivals: list[int] = field(init=False, default_factory=list, metadata=NOT_SAVED)
    # (9,) each, what those ways change of the drift: before the first arrival, from each one to the next
    _gains: list[FloatArray] = field(init=False, default_factory=lambda: [np.zeros(9)], metadata=NOT_SAVED)
    # as tracked, the first key scan of each submap
    _firsts: Rows[np.float64] = field(init=False, default_factory=new_poses, metadata=NOT_SAVED)
    # (9,) each, moments from each submap's first key scan to the next one's
    _steps: Rows[np.float64] = field(init=False, default_factory=_new_moments, metadata=NOT_SAVED)
    # from submap, to submap -> place of the most certain constraint in `_links`
    _link_places: dict[tuple[int, int], int] = field(init=False, default_factory=dict, metadata=NOT_SAVED)
    _link_submaps: Rows[np.int32] = field(init=False, default_factory=_new_pairs, metadata=NOT_SAVED)
    # relative pose (3,) of the first key scan of the submap from which it leads, and moments (9,)
    _links: Rows[np.float64] = field(init=False, default_factory=_new_links, metadata=NOT_SAVED)

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

    @property
    def complete_submaps(self) -> int:
        """Number of submaps that are complete."""
        return len(self) // KEY_SCANS_PER_SUBMAP

    def driven_m(self) -> FloatArray:
        """Metres driven (T,) up to each key scan, as tracked."""
        return np.array(self._driven_m)

    @property
    def newest_m(self) -> float:
        """Metres driven up to the newest key scan."""
        return self._driven_m[-1]

    @property
    def stretches(self) -> int:
        """Number of stretches that gaps in the laser data separate."""
        return self._gap_counts[-1] + 1

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
        links = (self._link_places, self._link_submaps, self._links)
        along = (self._driven_m, self._gap_counts, self._sums, self._drifts)
        for derived in (*along, self._firsts, self._steps, *links, self._arrivals):
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
        return between(self.tracked[anchor], _select_poses(self.tracked, keys))

    def relative_pose(self, anchor: int, key: int) -> FloatArray:
        """Pose (3,) of a key scan seen from another: as tracked where they are near in time, else as the map has it."""
        frame = self.tracked if abs(anchor - key) <= 3 * KEY_SCANS_PER_SUBMAP else self.poses
        return between(frame[anchor], frame[key])

    def find_distance_to(self, submap: int, key: int, limit_m: float, most: int) -> SubmapDistance | None:
        """Give the one of `find_nearby_submaps` that is a submap; None if it is not among them."""
        found = self.find_nearby_submaps(key, limit_m, most, submap)
        return found[-1] if found.submaps[-1] == submap else None

    def locate(self, key: int, anchors: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return poses (A, 3) of a key scan seen from others (A,), and covariances (A, 3, 3), by the most certain ways.

        Covariances are in the map frame, and those of the drift model's bounds, a gap within a submap included.
        """
        nearby = self.find_nearby_submaps(key, math.inf, len(self))
        place = np.empty(submap_of(len(self)) + 1, np.int64)
        place[nearby.submaps] = np.arange(len(nearby))
        firsts = first_key_scan(submap_of(anchors))
        ways = place[submap_of(anchors)]
        own = between(_select_poses(self.tracked, anchors), _select_poses(self.tracked, firsts))
        sums = [self._sums[key] for key in firsts.tolist()], [self._sums[key] for key in anchors.tolist()]
        within = propagate_covariances(self.poses[key], np.subtract(sums[1], sums[0]))
        return compose(own, nearby.poses[ways]), nearby.covariances[ways] + within

    def find_nearby_submaps(self, key: int, limit_m: float, most: int, last: int = -1) -> NearbySubmaps:
        """Find submaps by the most certain ways to them, in the order of their uncertainty as seen from a key scan.

        The search ends at a standard deviation of the position of `limit_m`, after `most` submaps, or at submap `last`.
        """
        here = submap_of(key)
        x, y, _ = self.poses[key].tolist()
        submaps, moments, ends = backend.shortest_ways(
            *(self._firsts.array, self._steps.array, self._link_submaps.array, self._links.array),
            *(here, self._sums[key] - self._sums[first_key_scan(here)], self.tracked[key], x, y),
            *(limit_m**2, most, last),
        )
        poses = between(self._firsts.array[submaps], ends)
        return NearbySubmaps(submaps.astype(np.int64), poses, propagate_covariances(self.poses[key], moments))

    def label_gaps(self) -> IntArray:
        """Label (T,) of the stretch without a gap in the laser data that each key scan belongs to, ascending."""
        return np.array(self._gap_counts)

    def label_rigid_components(self, constraints: Sequence[Constraint] | None = None) -> IntArray:
        """Label (T,) of the rigid component of each key scan, the number of its first stretch without a gap.

        Components are separated by gaps in the laser data, and joined by tracked or recognized constraints and by those
        added by hand: by those of the graph, if no others are given.
        """
        if not self._gap_counts[-1]:
            return np.zeros(len(self), np.int64)
        labels = np.array(self._gap_counts)
        roots = np.arange(labels[-1] + 1)
        for constraint in self.constraints if constraints is None else constraints:
            if constraint.determined and constraint.source is not ConstraintSource.PROXIMITY:
                a = roots[labels[constraint.from_]]
                b = roots[labels[constraint.to]]
                if a != b:
                    roots[roots == max(a, b)] = min(a, b)
        components: IntArray = roots[labels]
        return components

    def select_without_gap(self, keys: IntArray, anchor: int) -> IntArray:
        """Select those of consecutive key scans (K,) that no gap separates from `anchor`."""
        if self._gap_counts[keys[0]] == self._gap_counts[keys[-1]]:
            return keys
        side = np.array(self._gap_counts[keys[0] : keys[-1] + 1])
        here: IntArray = keys[side == side[anchor - keys[0]]]
        return here

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

    def snapshot(self) -> KeyGraph:
        """Return a copy for later; arrays that never change are shared."""
        twin = KeyGraph()
        for own in fields(self):
            value = getattr(self, own.name)
            setattr(twin, own.name, value if isinstance(value, int | None) else value.copy())
        return twin

    def _derive(self) -> None:
        """Extend the values derived from poses and variances to the newest key scan."""
        for key in range(len(self._sums), len(self)):
            x, y, theta = self.poses[key].tolist()
            position, heading = self.variances[key]
            step = self.tracked[key] - self.tracked[max(key - 1, 0)]
            self._driven_m.append((self._driven_m[-1] if key else 0.0) + math.hypot(step[0], step[1]))
            is_gap = position > BLIND_SIGMA_M**2 or heading > BLIND_SIGMA_RAD**2
            self._gap_counts.append((self._gap_counts[-1] if key else 0) + is_gap)
            moments = _moments((x, y), position, 0.0, position, heading)
            self._sums.append(self._sums[-1] + moments if key else moments)
            (xx, xy, _), (_, yy, _), (_, _, heading) = self.drift_covariances[key].tolist()
            c = math.cos(theta)
            s = math.sin(theta)
            turned = c * c * xx - 2 * c * s * xy + s * s * yy, c * s * (xx - yy) + (c * c - s * s) * xy
            moments = _moments((x, y), *turned, s * s * xx + 2 * c * s * xy + c * c * yy, heading)
            self._drifts.append(self._drifts[-1] + moments if key else np.zeros(9))  # the first pose is the origin
            if key % KEY_SCANS_PER_SUBMAP == 0:
                self._firsts.append(self.tracked[key])
                if key:
                    self._steps.append(self._sums[key] - self._sums[key - KEY_SCANS_PER_SUBMAP])

    def _use(self, constraints: Sequence[Constraint]) -> None:
        """Let constraints lead from submap to submap, and shorten the ways from the first key scan.

        In the order in which they were found, one by one: a graph that was saved goes on to the last bit.
        """
        determined = [constraint for constraint in constraints if constraint.determined]
        if not determined:
            return
        covariances = np.asarray(np.linalg.inv(np.array([c.information for c in determined])), np.float64)
        for constraint, covariance in zip(determined, covariances, strict=True):
            self._add_link(constraint, covariance)
            self._shorten_ways(constraint, covariance)

    def _drift_at(self, key: int) -> FloatArray:
        """Moments (9,) of the drift from key scan 0 to another, along the most certain known way."""
        return self._drifts[key] + self._gains[bisect_right(self._arrivals, key)]

    def _shorten_ways(self, constraint: Constraint, covariance: FloatArray) -> None:
        """Let the way to a key scan and to those after it come by a constraint if it is more certain so."""
        at = constraint.to
        measured = compute_step_moments(as_pose(self.poses[at]), _MATCH_RATIO**2 * covariance)
        gained = self._drift_at(constraint.from_) + measured - self._drift_at(at)
        if _position_variance(self.poses[at], gained) >= 0:
            return
        later = bisect_right(self._arrivals, at)
        gain = self._gains[later] + gained
        if later and self._arrivals[later - 1] == at:
            self._gains[later] = gain
        else:
            self._arrivals.insert(later, at)
            self._gains.insert(later + 1, gain)

    def _add_link(self, constraint: Constraint, covariance: FloatArray) -> None:
        """Add the link of a constraint between two submaps if it is the most certain so far."""
        a = submap_of(constraint.from_)
        b = submap_of(constraint.to)
        sums = self._sums
        x, y, _ = self.poses[constraint.to].tolist()
        xx, yy, heading = covariance.diagonal().tolist()
        own = _moments((x, y), 0.5 * (xx + yy), 0.0, 0.5 * (xx + yy), heading)
        within = (sums[constraint.from_] - sums[first_key_scan(a)]) + (sums[constraint.to] - sums[first_key_scan(b)])
        total = within + own
        place = self._link_places.get((a, b))
        known = None if place is None else self._links.array[place]
        if known is None or total[0] + total[3] < known[3] + known[6]:
            anchor, from_, to, end = (
                as_pose(self.tracked[key])
                for key in (first_key_scan(a), constraint.from_, constraint.to, first_key_scan(b))
            )
            measured = single_pose.compose(as_pose(constraint.measurement), single_pose.between(to, end))
            there = single_pose.compose(single_pose.between(anchor, from_), measured)
            self._set_link(a, b, single_pose.between(there, ORIGIN), total)
            self._set_link(b, a, there, total)

    def _set_link(self, a: int, b: int, there: Pose, moments: FloatArray) -> None:
        """Let a link lead from submap `a` to submap `b`, from which the first key scan of `a` lies at `there`."""
        place = self._link_places.setdefault((a, b), len(self._links))
        if place == len(self._links):
            self._links.append(0.0)
            self._link_submaps.append((a, b))
        link = self._links.array[place]
        link[:3] = there
        link[3:] = moments


def _select_poses(poses: Sequence[FloatArray], keys: IntArray) -> FloatArray:
    """Those (K, 3) of some key scans (K,)."""
    return np.array([poses[key] for key in keys.tolist()]).reshape(-1, 3)


def _moments(place: tuple[float, float], xx: float, xy: float, yy: float, heading: float) -> FloatArray:
    """`compute_moments` (9,) of one step, by the covariance of its position, map frame, and the heading's variance."""
    x, y = place
    return np.array((xx, xy, yy, heading, heading * x, heading * y, heading * x * x, heading * x * y, heading * y * y))


def _position_variance(pose: FloatArray, moments: FloatArray) -> float:
    """Trace of the position's covariance at a pose (3,) that `propagate_covariances` makes of moments (9,)."""
    pxx, _, pyy, q, qx, qy, qxx, _, qyy = moments.tolist()
    x, y, _ = pose.tolist()
    variance: float = (pxx + q * y * y - 2 * qy * y + qyy) + (pyy + q * x * x - 2 * qx * x + qxx)
    return variance
