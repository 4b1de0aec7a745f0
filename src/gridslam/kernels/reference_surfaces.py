"""How well the surfaces of scans fit each other, in plain NumPy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Places = NDArray[np.int64]

ALONG_M = 0.2
"""Longest way along a line from its point, where points weigh by their incidence."""
BESIDE = 3
"""Points on either side of a bearing among which the nearest is searched."""
NEAR_M = 0.5
CORNER = 4.0
"""A line ends at a point to one side of which the variance is so much less."""
LEAST_COSINE = 0.9
"""Of the angle between normals of one surface."""
LEAST_VARIANCE = 0.2
"""Of a point across its line where a beam grazes it, to that of half of one that hits it head on."""
LINE_BESIDE = 2
"""Neighbours on either side of a point with which a line is fitted."""
LONGEST_GAP_M = 0.4
LONGEST_GAP_RATIO = 0.05
"""Neighbours on one surface are no farther apart, by metres, and by metres for each metre of range."""
MOST_VARIANCE = 0.002
"""Of the distances from a longer line, m^2, at most: 4.5 cm."""
MOST_SPREAD_M = 0.06
"""Root of the summed squares of distances from the line, at most: corners have no normal."""
REACH_M = 30.0


def rank_bearings(ways: Numbers) -> Numbers:
    """Numbers (B,) from -2 to 2 that ascend with the bearings of ways (B, 2) from -pi to pi."""
    x, y = ways.T
    size = np.abs(x) + np.abs(y)
    rank = np.divide(y, size, out=np.zeros(len(y)), where=size > 0)
    return np.asarray(np.where(x >= 0, rank, np.where(y >= 0, 2.0 - rank, -2.0 - rank)), np.float64)


def fit_surfaces(
    ends: Numbers, starts: Places, origins: Numbers, reach_m: float, threads: int
) -> tuple[Numbers, Numbers, Numbers, Places]:
    """Fit lines to the ends of neighbouring beams.

    Parameters
    ----------
    ends : (B, 2) float64, m
        Ends of the beams of S scans, base frame; scan s has those from starts[s] to starts[s + 1] - 1.
    starts, origins : (S + 1,) int64, (S, 2) float64
        Where scans begin, and where their lasers are.
    reach_m : float, m
        Each line is fitted to the points so near to one, or five at least; near a corner to those on one side of it.
        0: to five, two on either side.

    Returns
    -------
    points, normals : (K, 2) float64
        Of the beams that end on a line, with a reach moved onto it; normals point to the laser.
    bearings : (K,) float64
        Ranks of the bearings of the beams, ascending within a scan.
    starts : (S + 1,) int64
        Where the points of the scans begin.
    """
    scans = np.repeat(np.arange(len(origins)), np.diff(starts))
    ways = ends[starts[0] : starts[-1]] - origins[scans]
    order = np.lexsort((rank_bearings(ways), scans))
    ways = ways[order]
    x, y = ways.T
    squares = np.square(ways).sum(axis=1)
    is_near = np.hypot(*np.diff(ways, axis=0).T) < LONGEST_GAP_M + LONGEST_GAP_RATIO * np.sqrt(squares[:-1])
    is_near &= np.diff(scans) == 0
    if reach_m > 0:
        is_line, points, normals = _fit_long_lines(ways, is_near, reach_m)
        is_line &= squares < REACH_M**2
        own = scans[is_line]
        bearings = rank_bearings(ways[is_line])
        return points[is_line] + origins[own], normals[is_line], bearings, _count_up(own, len(origins))
    is_line = (squares < REACH_M**2) & _all_about(is_near, len(ways))
    count = 2 * LINE_BESIDE + 1
    mx, my = _sum_about(x) / count, _sum_about(y) / count
    xx = _sum_about(x * x) - count * mx * mx
    yy = _sum_about(y * y) - count * my * my
    xy = _sum_about(x * y) - count * mx * my
    is_line &= 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy) < MOST_SPREAD_M**2
    along = 0.5 * np.arctan2(2 * xy, xx - yy)[is_line]
    ways, own = ways[is_line], scans[is_line]
    normals = np.column_stack([-np.sin(along), np.cos(along)])
    normals[(normals * ways).sum(axis=1) > 0] *= -1
    return ways + origins[own], normals, rank_bearings(ways), _count_up(own, len(origins))


def _fit_long_lines(
    ways: Numbers, is_near: NDArray[np.bool_], reach_m: float
) -> tuple[NDArray[np.bool_], Numbers, Numbers]:
    """Whether each point of ways (B, 2) is on a line of those within reach; the place there, and the normal."""
    fewest = 2 * LINE_BESIDE
    surfaces = np.concatenate([[0], np.cumsum(~is_near)])[: len(ways)]
    is_line = np.zeros(len(ways), np.bool_)
    points, normals = ways.copy(), np.zeros_like(ways)
    for at, surface in enumerate(surfaces.tolist()):
        low, high = np.searchsorted(surfaces, [surface, surface + 1]).tolist()
        if high - low <= fewest:
            continue
        is_far = np.square(ways[low:high] - ways[at]).sum(axis=1) >= reach_m**2
        before, after = np.flatnonzero(is_far[: at - low]), np.flatnonzero(is_far[at - low :])
        first = low + int(before[-1]) + 1 if len(before) else low
        last = at + int(after[0]) - 1 if len(after) else high - 1
        while last - first < fewest:  # the others are farther off
            if first > low and (last == high - 1 or at - first <= last - at):
                first -= 1
            else:
                last += 1
        best = _fit_line(ways[first : last + 1])
        first, last = max(low, min(first, at - fewest)), min(high - 1, max(last, at + fewest))
        for begin, end in ((first, at), (at, last)):
            if end - begin >= fewest:
                line = _fit_line(ways[begin : end + 1])
                best = line if CORNER * line[2] < best[2] else best
        mean, along, variance = best
        normal = np.array([-np.sin(along), np.cos(along)])
        normals[at] = -normal if normal @ ways[at] > 0 else normal
        points[at] -= normals[at] * (normals[at] @ (ways[at] - mean))
        is_line[at] = variance < MOST_VARIANCE
    return is_line, points, normals


def _fit_line(points: Numbers) -> tuple[Numbers, float, float]:
    """Mean of points (K, 2), the direction of the line through them, and the variance of their distances from it."""
    mean = points.mean(axis=0)
    xx, xy, yy = np.cov(points.T, ddof=2)[[0, 0, 1], [0, 1, 1]].tolist()
    return mean, 0.5 * np.arctan2(2 * xy, xx - yy), 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)


def _count_up(scans: Places, count: int) -> Places:
    """Where the points of each of `count` scans begin, of which the scans (K,) are given."""
    return np.concatenate([[0], np.cumsum(np.bincount(scans, minlength=count))]).astype(np.int64)


def _sum_about(values: Numbers) -> Numbers:
    """Sum each of values (B,) and its neighbours on either side; zeros are beyond the ends."""
    padded = np.concatenate([np.zeros(LINE_BESIDE), values, np.zeros(LINE_BESIDE)])
    return np.asarray(sum(padded[k : k + len(values)] for k in range(2 * LINE_BESIDE + 1)), np.float64)


def _all_about(is_near: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """Whether all steps (B - 1,) are short from the second point before each of `count` to the second one after."""
    beyond = np.zeros(LINE_BESIDE, np.bool_)
    padded = np.concatenate([beyond, is_near, beyond])
    return np.asarray(np.logical_and.reduce([padded[k : k + count] for k in range(2 * LINE_BESIDE)]), np.bool_)


def project_on_determined(information: Numbers, counts: Numbers, least_information: float) -> Numbers:
    """Projections (P, 3, 3) that take out the directions of the position that the information (P, 3, 3) leaves open.

    Directions with less information than `least_information` for each of `counts` (P,) points are.
    """
    values, across = np.linalg.eigh(information[:, :2, :2])
    is_open = values < least_information * counts[:, None]
    projections = np.tile(np.eye(3), (len(information), 1, 1))
    projections[:, :2, :2] -= np.einsum("pik,pk,pjk->pij", across, is_open.astype(np.float64), across)
    return projections


def match_to_surfaces(
    points: Numbers,
    normals: Numbers,
    bearings: Numbers,
    starts: Places,
    origins: Numbers,
    poses: Numbers,
    ends: Numbers,
    guess: tuple[float, float, float],
    prior: Numbers,
    gates_m: Numbers,
    scale_m: float,
    least_information: float,
) -> tuple[tuple[float, float, float], int]:
    """Match one scan to the surfaces of others by Gauss-Newton, point to line.

    Parameters
    ----------
    points, normals, bearings, starts, origins
        Of S scans, see `match_surfaces`.
    poses : (S, 3) float64
        Where they are.
    ends : (K, 2) float64
        Of the scan's beams, base frame; each is matched with the nearest line, whatever its direction.
    guess : (float, float, float)
        About where it is.
    prior : (3,) float64
        Information (1/m^2, 1/m^2, 1/rad^2) of the guess, in the frame of the scan.
    gates_m : (G,) float64, m
        Largest residual in each step.
    scale_m : float, m
        Residual of which the weight is a half, and their standard deviation.
    least_information : float
        See `project_on_determined`.

    Returns
    -------
    pose : (float, float, float)
    count : int
        Points matched in the step where they were the fewest.
    """
    count = len(poses)
    whole = (
        np.concatenate([points[: starts[-1]], ends]),
        np.concatenate([normals[: starts[-1]], np.full(ends.shape, np.nan)]),
        np.concatenate([bearings[: starts[-1]], np.empty(len(ends))]),
        np.append(starts, starts[-1] + len(ends)),
        np.concatenate([origins, np.zeros((1, 2))]),
    )
    pairs = np.column_stack([np.arange(count), np.full(count, count)])
    pose = np.array(guess)
    fewest = count * len(ends)
    for gate_m in gates_m.tolist():
        sums = match_surfaces(*whole, np.concatenate([poses, pose[None]]), pairs, gate_m, scale_m, False, False, 1)
        sums = sums.sum(axis=0)
        fewest = min(fewest, int(sums[9]))
        information = sums[[[0, 1, 2], [1, 3, 4], [2, 4, 5]]]
        (kept,) = project_on_determined(information[None], sums[9:10], least_information)
        away = _rotate(-guess[2], pose - np.array(guess))
        own = 0.5 / scale_m**2 * (kept @ information @ kept) + np.diag(prior)
        step = np.linalg.solve(own, 0.5 / scale_m**2 * (kept @ sums[6:9]) + prior * away)
        pose = pose - _rotate(pose[2], step)
    x, y, theta = pose.tolist()
    return (x, y, theta), fewest


def _rotate(angle: float, increment: Numbers) -> Numbers:
    """Turn the position of an increment (3,)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, turn = increment
    return np.array([c * x - s * y, s * x + c * y, turn])


def match_surfaces(
    points: Numbers,
    normals: Numbers,
    bearings: Numbers,
    starts: Places,
    origins: Numbers,
    poses: Numbers,
    pairs: Places,
    gate_m: float,
    scale_m: float,
    both: bool,
    by_incidence: bool,
    threads: int,
) -> Numbers:
    """Normal equations of the relative poses of pairs of scans, point to line (Chen and Medioni 1992).

    A point is matched with the nearest one among those of about the same bearing, where normals agree. The residual is
    its distance along the other's normal, with a Cauchy weight. Points beyond the bearings of the other scan do not
    count: its outermost line, whose normal is noisy, would pull all of them toward itself, and shorten corridors.

    Parameters
    ----------
    points, normals : (B, 2) float64
        Of S scans, base frame; scan s has those from starts[s] to starts[s + 1] - 1.
    bearings : (B,) float64
        Ranks of the bearings of the points from the laser (`rank_bearings`), ascending within a scan.
    starts, origins : (S + 1,) int64, (S, 2) float64
        Where scans begin, and where their lasers are.
    poses : (S, 3) float64
        Where the scans are, map frame.
    pairs : (P, 2) int64
        Scans `from` and `to`.
    gate_m, scale_m : float, m
        Largest residual, and that of which the weight is a half.
    both : bool
        Whether points of `from` are matched with lines of `to`, too, or only those of `to` with lines of `from`.
    by_incidence : bool
        Whether a point weighs by its beam's incidence and its partner's: the noise of a range moves it along a wall
        that is grazed, and hardly across. It then has no partner farther along the wall than the line was fitted.

    Returns
    -------
    (P, 11) float64
        By the error e of the pose of `to` seen from `from`, in the frame of `to` (`PoseGraph.errors`): the sums of
        w g g' (upper triangle, row by row) and of w g r, for slopes g = dr/de; the number of matched points; and the
        sum of r^2.
    """
    out = np.zeros((len(pairs), 11))
    whole = points, normals, bearings, starts, origins
    for row, (from_, to) in zip(out, pairs.tolist(), strict=True):
        for fixed, moved in ((from_, to), (to, from_))[: 1 + both]:
            found = match_points(whole, poses, np.array([[fixed, moved]]), gate_m, by_incidence)
            slope = found.slopes if moved == to else found.slopes_of_fixed
            weighted = slope / (found.variances + np.square(found.residuals / scale_m))[:, None]
            row[:6] += (weighted.T @ slope)[np.triu_indices(3)]
            row[6:9] += weighted.T @ found.residuals
            row[9] += len(found.residuals)
            row[10] += np.square(found.residuals).sum()
    return out


class MatchedPoints(NamedTuple):
    """Points of scans on lines of others.

    Attributes
    ----------
    residuals : (K,) float64, m
        Distances from the lines.
    slopes, slopes_of_fixed : (K, 3) float64
        Their derivatives by the error of the pose of the scan with the points, in its frame; and of that with the
        lines.
    variances : (K,) float64
        What they weigh by, see `match_surfaces`.
    """

    residuals: Numbers
    slopes: Numbers
    slopes_of_fixed: Numbers
    variances: Numbers


def match_points(
    surfaces: tuple[Numbers, Numbers, Numbers, Places, Numbers],
    poses: Numbers,
    pairs: Places,
    gate_m: float,
    by_incidence: bool,
) -> MatchedPoints:
    """Match points with lines, in pairs (P, 2) of the scan with the lines and that with the points.

    The other arguments are those of `match_surfaces`; points whose normal is NaN fit lines of all directions.
    """
    points, normals, bearings, starts, origins = surfaces
    fixed, moved = pairs.T
    counts = starts[moved + 1] - starts[moved]
    ends = np.cumsum(counts)
    pair = np.repeat(np.arange(len(pairs)), counts)
    own = np.arange(len(pair)) + (starts[moved] - ends + counts)[pair]
    x, y, turn = (poses[moved] - poses[fixed]).T
    c, s = np.cos(poses[fixed, 2]), np.sin(poses[fixed, 2])
    away = np.column_stack([c * x + s * y, c * y - s * x])
    c, s = np.cos(turn)[pair], np.sin(turn)[pair]
    x, y = points[own].T
    at = np.column_stack([c * x - s * y, s * x + c * y]) + away[pair]
    first, last = starts[fixed][pair], starts[fixed + 1][pair]
    ranks = rank_bearings(at - origins[fixed][pair])
    place = first.copy()
    for scan, begin, end in zip(fixed.tolist(), (ends - counts).tolist(), ends.tolist(), strict=True):
        place[begin:end] += np.searchsorted(bearings[starts[scan] : starts[scan + 1]], ranks[begin:end])
    near = place[:, None] + np.arange(-BESIDE, BESIDE)
    is_there = (near >= first[:, None]) & (near < last[:, None])
    near = np.clip(near, first[:, None], last[:, None] - 1)  # without a line none is there
    squares = np.square(at[:, :1] - points[near, 0]) + np.square(at[:, 1:] - points[near, 1])
    squares[~is_there] = np.inf
    best = squares.argmin(axis=1)[:, None]
    line, nearest = np.take_along_axis(near, best, 1)[:, 0], np.take_along_axis(squares, best, 1)[:, 0]
    normal = normals[line]
    towards = np.column_stack([c * normal[:, 0] + s * normal[:, 1], c * normal[:, 1] - s * normal[:, 0]])
    residual = ((at - points[line]) * normal).sum(axis=1)
    fits = (place > first) & (place < last) & (nearest < NEAR_M**2)
    fits &= ~((towards * normals[own]).sum(axis=1) < LEAST_COSINE)
    fits &= np.abs(residual) <= gate_m
    variance = np.ones(len(at))
    if by_incidence:
        fits &= nearest - np.square(residual) <= ALONG_M**2
        own_squares = _squared_cosines(points[own] - origins[moved][pair], normals[own])
        variance = LEAST_VARIANCE + 0.5 * (own_squares + _squared_cosines(points[line] - origins[fixed][pair], normal))
    of_fixed = -np.column_stack([normal, normal[:, 1] * at[:, 0] - normal[:, 0] * at[:, 1]])
    slope = np.column_stack([towards, towards[:, 1] * x - towards[:, 0] * y])
    found = MatchedPoints(residual, slope, of_fixed, variance)
    return MatchedPoints._make(each[fits] for each in found)


def _squared_cosines(ways: Numbers, normals: Numbers) -> Numbers:
    """Of the incidence of beams along ways (K, 2) on lines with normals (K, 2)."""
    squares = np.square(ways).sum(axis=1)
    return np.asarray(np.square((ways * normals).sum(axis=1)) / np.maximum(squares, 1e-12), np.float64)
