"""Errors of a trajectory against a reference: absolute (ATE), relative (RPE), and by known relations."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.types import FloatArray, IntArray, Trajectory

_TOLERANCE_NS = 1_000_000
MAX_GAP_NS = 1_000_000_000
"""Between poses of a reference that are farther apart in time nothing is interpolated: a robot may turn in it."""


@checked
@dataclass(frozen=True, slots=True)
class PoseErrors:
    """Statistics of pose errors: translation as a Euclidean length in m, rotation as an absolute angle in degrees.

    `n` counts the errors; std is that of the population.
    """

    n: int
    trans_mean_m: float
    trans_std_m: float
    trans_rmse_m: float
    trans_max_m: float
    rot_mean_deg: float
    rot_std_deg: float
    rot_rmse_deg: float
    rot_max_deg: float

    @classmethod
    def of(cls, errors: FloatArray) -> PoseErrors:
        """Summarize error poses (N, 3), N >= 1."""
        trans = np.hypot(errors[:, 0], errors[:, 1])
        return cls(len(errors), *_statistics(trans), *_statistics(np.degrees(np.abs(errors[:, 2]))))


def _statistics(values: FloatArray) -> tuple[float, float, float, float]:
    rmse = float(np.sqrt(np.mean(np.square(values))))
    return float(values.mean()), float(values.std()), rmse, float(values.max())


def _neighbours(stamps: IntArray, times: IntArray) -> tuple[IntArray, IntArray]:
    """Return indices of the ascending stamps that enclose each time; the outermost two beyond the ends."""
    last = len(stamps) - 1
    high = np.clip(np.searchsorted(stamps, times), min(1, last), last)
    return np.maximum(high - 1, 0), high


@checked
def interpolate(
    trajectory: Trajectory, stamps_ns: ArrayLike, *, tolerance_ns: int = _TOLERANCE_NS
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Poses of a trajectory at given times: x and y linear, theta along the shorter arc, between neighbours in time.

    Raises ArgumentError where the trajectory is empty or a time lies outside it by more than the tolerance.

    Parameters
    ----------
    trajectory : Trajectory
        At least one pose; taken in the order of the stamps, which may jitter backwards.
    stamps_ns : (M,) int64, ns
        When.
    tolerance_ns : int, ns, >= 0
        How far from a given pose's stamp a time still counts as exact, and how far it may lie outside the trajectory.

    Returns
    -------
    poses : (M, 3) float64
        Poses at the times.
    exact : (M,) bool
        Whether a given pose stands within the tolerance.
    """
    if len(trajectory) == 0:
        raise ArgumentError("trajectory", "at least one pose", "none")
    order = np.argsort(trajectory.stamps_ns, kind="stable")
    stamps = trajectory.stamps_ns[order]
    poses = trajectory.poses[order]
    times: IntArray = np.asarray(stamps_ns, dtype=np.int64)
    outside = times[(times < stamps[0] - tolerance_ns) | (times > stamps[-1] + tolerance_ns)]
    if len(outside):
        span = f"times from {stamps[0]} to {stamps[-1]} ns"
        raise ArgumentError("stamps_ns", span, f"{len(outside)} outside, the first {outside[0]}")
    low, high = _neighbours(stamps, times)
    span_ns = np.maximum(stamps[high] - stamps[low], 1)
    weight = np.clip((times - stamps[low]) / span_ns, 0.0, 1.0)
    step = poses[high] - poses[low]
    step[:, 2] = wrap(step[:, 2])
    between_them = poses[low] + weight[:, None] * step
    between_them[:, 2] = wrap(between_them[:, 2])
    return between_them, np.minimum(np.abs(stamps[high] - times), np.abs(times - stamps[low])) <= tolerance_ns


def clip_to_truth(estimate: Trajectory, truth: Trajectory) -> tuple[Trajectory, Trajectory] | None:
    """Return poses of the estimate within the truth's span, and the truth at their stamps; None where there is none.

    The truth has at least one pose, and ascending stamps.
    """
    stamps = estimate.stamps_ns
    within = (stamps >= truth.stamps_ns[0]) & (stamps <= truth.stamps_ns[-1])
    if not within.any():
        return None
    found = Trajectory(stamps[within], estimate.poses[within])
    return found, Trajectory(found.stamps_ns, interpolate(truth, found.stamps_ns)[0])


@checked
def associate(
    estimate: Trajectory, reference: Trajectory, *, tolerance_ns: int = 20_000_000
) -> tuple[IntArray, IntArray]:
    """Pair each pose of an estimate with the reference's pose nearest in time, if within the tolerance.

    Parameters
    ----------
    estimate, reference : Trajectory
        In any order of stamps.
    tolerance_ns : int, ns, >= 0
        Greatest difference of stamps; 20 ms is half the period of a 25 Hz lidar.

    Returns
    -------
    of_estimate, of_reference : (K,) int64
        Indices of the pairs, in the estimate's order; a reference's pose may have several partners.
    """
    if len(reference) == 0:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    order = np.argsort(reference.stamps_ns, kind="stable")
    stamps = reference.stamps_ns[order]
    below, above = _neighbours(stamps, estimate.stamps_ns)
    to_above = np.abs(stamps[above] - estimate.stamps_ns)
    to_below = np.abs(estimate.stamps_ns - stamps[below])
    nearest = np.where(to_below < to_above, below, above)
    paired = np.flatnonzero(np.minimum(to_below, to_above) <= tolerance_ns)
    return paired, order[nearest[paired]]


def _pair_poses(
    estimate: Trajectory, reference: Trajectory, tolerance_ns: int, max_gap_ns: int
) -> tuple[FloatArray, FloatArray]:
    """Return poses of the estimate, and those of the reference at their stamps.

    These are the reference's own where it has that stamp, else interpolated where it has poses before and after that
    are `max_gap_ns` apart or less, else the nearest within `tolerance_ns`.
    """
    of_estimate, of_reference = associate(estimate, reference, tolerance_ns=tolerance_ns)
    truth = np.full((len(estimate), 3), np.nan)
    truth[of_estimate] = reference.poses[of_reference]
    stamps = np.sort(reference.stamps_ns)
    if len(stamps):
        low, high = _neighbours(stamps, estimate.stamps_ns)
        enclosed = (stamps[low] < estimate.stamps_ns) & (estimate.stamps_ns < stamps[high])
        enclosed &= stamps[high] - stamps[low] <= max_gap_ns
        truth[enclosed] = interpolate(reference, estimate.stamps_ns[enclosed])[0]
    paired = np.isfinite(truth[:, 0])
    if not paired.any():
        times = f"a stamp within {tolerance_ns} ns of one of the reference, or between two of {max_gap_ns} ns or less"
        raise ArgumentError("estimate", times, _compare_spans(estimate, stamps))
    return estimate.poses[paired], truth[paired]


def _compare_spans(estimate: Trajectory, stamps: IntArray) -> str:
    """Describe times that have nothing in common."""
    if not len(stamps) or not len(estimate):
        return "none"
    (first, last), (begin, end) = ((of.min() / 1e9, of.max() / 1e9) for of in (estimate.stamps_ns, stamps))
    return f"none: from {first:.3f} to {last:.3f} s, and the reference from {begin:.3f} to {end:.3f} s"


@checked
def align(source: FloatArray, target: FloatArray) -> FloatArray:
    """Rigid motion that brings points onto their partners with the least sum of squared distances, without scale.

    Parameters
    ----------
    source, target : (N, 2) float64, m
        Partners, N >= 1.

    Returns
    -------
    (3,) float64
        Pose `target_from_source`. Its heading is 0 where the points do not determine it (all in one place).

    References
    ----------
    S. Umeyama, Least-squares estimation of transformation parameters between two point patterns, PAMI 1991, in
    the plane, where the rotation is the angle of the summed products taken as complex numbers.
    """
    source_mean = source.mean(axis=0)
    target_mean = target.mean(axis=0)
    a = source - source_mean
    b = target - target_mean
    theta = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    c = np.cos(theta)
    s = np.sin(theta)
    shift = target_mean - np.array([[c, -s], [s, c]]) @ source_mean
    return np.array([shift[0], shift[1], wrap(theta)])


@checked
def absolute_errors(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    aligned: bool = True,
    tolerance_ns: int = 20_000_000,
    max_gap_ns: int = MAX_GAP_NS,
) -> PoseErrors:
    """Return absolute trajectory error (ATE): how far the poses lie from the reference's, after alignment on SE(2).

    Parameters
    ----------
    estimate, reference : Trajectory
        What is judged, and the truth.
    aligned : bool
        Whether the estimate is first moved as a whole to where it fits best; False where both share one map frame.
    tolerance_ns : int, ns, >= 0
        For `associate`; poses without partner do not count (compare `n`).
    max_gap_ns : int, ns, >= 0
        The reference is interpolated between poses that are no farther apart.

    Raises
    ------
    ArgumentError
        No pose has a partner.

    References
    ----------
    J. Sturm et al., A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012.
    """
    ours, truth = _pair_poses(estimate, reference, tolerance_ns, max_gap_ns)
    if aligned:
        ours = compose(align(ours[:, :2], truth[:, :2]), ours)
    return PoseErrors.of(between(truth, ours))


@checked
def relative_errors_by_distance(
    estimate: Trajectory,
    reference: Trajectory,
    distance_m: float,
    *,
    tolerance_ns: int = 20_000_000,
    max_gap_ns: int = MAX_GAP_NS,
) -> PoseErrors:
    """Relative pose error (RPE) from each pose to the first that lies `distance_m` > 0 farther along the reference.

    Raises ArgumentError where `distance_m` is not positive or longer than the reference's path.

    Source: J. Sturm et al., IROS 2012, with pairs chosen by path length.
    """
    if not distance_m > 0:
        raise ArgumentError("distance_m", "a length above 0 m", distance_m)
    ours, truth = _pair_poses(estimate, reference, tolerance_ns, max_gap_ns)
    path = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    second = np.searchsorted(path, path + distance_m)
    first = np.flatnonzero(second < len(path))
    if len(first) == 0:
        raise ArgumentError("distance_m", f"at most the path's {path[-1]:.3f} m", distance_m)
    true_step = between(truth[first], truth[second[first]])
    return PoseErrors.of(between(true_step, between(ours[first], ours[second[first]])))


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """True relative poses: where the robot stood at times `to_ns`, seen from where it was at times `from_ns`.

    `from_ns` and `to_ns` are (M,) int64 ns, `poses` (M, 3) float64, M >= 1.

    Raises ArgumentError where lengths differ or there is no relation.
    """

    from_ns: IntArray
    to_ns: IntArray
    poses: FloatArray

    def __post_init__(self) -> None:
        """Check that each relation has two times and a pose."""
        if not len(self.from_ns) == len(self.to_ns) == len(self.poses) > 0 or self.poses.shape[1:] != (3,):
            shapes = (self.from_ns.shape, self.to_ns.shape, self.poses.shape)
            raise ArgumentError("Relations", "shapes (M,), (M,), (M, 3), M > 0", shapes)


def clip_relations(relations: Relations, trajectory: Trajectory) -> Relations:
    """Return the relations whose times lie within the trajectory's; raises ArgumentError where there is none."""
    first = trajectory.stamps_ns.min() - _TOLERANCE_NS
    last = trajectory.stamps_ns.max() + _TOLERANCE_NS
    times = np.array([relations.from_ns, relations.to_ns])
    within = ((times >= first) & (times <= last)).all(axis=0)
    if not within.any():
        raise ArgumentError("reference", "a relation within the time that was mapped", "none")
    return Relations(relations.from_ns[within], relations.to_ns[within], relations.poses[within])


@final
@dataclass(frozen=True, slots=True)
class RelationErrors(PoseErrors):
    """Statistics over `n` relations, as those of poses.

    `exact` is the share of the relations' times with a pose of the trajectory within 1 ms; the rest were interpolated.
    """

    exact: float


@checked
def relation_errors(trajectory: Trajectory, relations: Relations) -> RelationErrors:
    """Score a trajectory: component difference of each estimated and true relative pose.

    Parameters
    ----------
    trajectory : Trajectory
        Poses in any frame; only relative ones count.
    relations : Relations
        Truth between pairs of times.

    Raises
    ------
    ArgumentError
        A time lies outside the trajectory by more than 1 ms.

    References
    ----------
    R. Kuemmerle et al., On measuring the accuracy of SLAM algorithms, Autonomous Robots 27 (2009), Section 3,
    with translation and rotation reported apart and not squared.
    """
    first, exact_first = interpolate(trajectory, relations.from_ns)
    second, exact_second = interpolate(trajectory, relations.to_ns)
    error = between(first, second) - relations.poses
    error[:, 2] = wrap(error[:, 2])
    exact = float((exact_first.mean() + exact_second.mean()) / 2)
    return RelationErrors(**asdict(PoseErrors.of(error)), exact=exact)
