"""The NumPy twins of the compiled kernels: readable, the oracle of their tests, and the fallback.

All functions but `max_pyramid`, `correlate`, `sum_at_ends` and those of surfaces, which work on what they are given,
work on maps of one layout, five arguments that always come first:

roots : (R, P, Q) int32
    For each map (row) a table of page ids; ``roots[r, 0, 0]`` is the page at page coordinates `first`.
first : (int, int)
    Page row and page column of the table's corner; signed.
pages : (K, 16, 16) int32
    Tile ids; page 0 is empty.
log_odds : (T, 32, 32) int8 or int16
    In units that the caller chooses; the least value of the type is unknown. Tile 0 is unknown all over.
field : (T, 32, 32) uint8
    255 at an occupied cell, falling with the distance to 0 at the field's reach; tile 0 is 0 all over.

A cell is [row y, column x] with cell (0, 0) at the world's origin, indices signed; what lies outside a table is empty.
Poses are ``[x m, y m, theta rad]``; `ends` and `origin` are points of the robot's base frame in m; `rows` is the index
of the map of each pose, each map at most once where the kernel writes. `threads` is for the compiled kernels alone.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels.reference_maps import update
from gridslam.kernels.reference_surfaces import fit_surfaces, match_surfaces, match_to_surfaces
from gridslam.kernels.reference_update import (
    FARTHEST,
    OCCUPIED,
    PAGE,
    TILE,
    FloatArray,
    Int32Array,
    IntArray,
    LogOdds,
    cell_addresses,
    cells_within,
    make_tiles_writable,
    tiles_on_rays,
    transform_to_world,
    unknown_of,
)

__all__ = [
    "cast_rays",
    "correlate",
    "distances",
    "fit_surfaces",
    "known_cells",
    "make_tiles_writable",
    "match",
    "match_pose",
    "match_surfaces",
    "match_to_surfaces",
    "max_pyramid",
    "sum_at_ends",
    "tiles_on_rays",
    "update",
]


FloatMap = NDArray[np.float32]

_SINGULAR = 1e-18  # least eigenvalue of a matrix that can be inverted
_PIN = 1e6  # information, 1 / cell^2, that pins the guess along an undetermined direction
_BASE = np.float32(6.0)  # cells between the ends that must lie on a line to be a wall
_ASIDE = np.float32(0.6)  # cells by which they may miss it: more than a lidar scatters
_BEYOND = 3.0  # the gradient leans 55 degrees from the normal of the wall: there its mapped part ends


@final
class _Field(NamedTuple):
    """Reads the distance fields of maps `rows` (K,)."""

    roots: Int32Array
    first: tuple[int, int]
    pages: Int32Array
    values: NDArray[np.uint8]
    rows: Int32Array

    def cell_addresses(self, y: IntArray, x: IntArray) -> IntArray:
        """Positions (K, B) of cells y, x (K, B) in the flattened tiles."""
        return cell_addresses(self.roots, self.first, self.pages, self.rows[:, None], y, x)

    def at(self, y: IntArray, x: IntArray) -> NDArray[np.uint8]:
        """Values (K, B) at cells y, x (K, B)."""
        return self.values.reshape(-1)[self.cell_addresses(y, x)]

    def sample(self, u: FloatArray, v: FloatArray) -> tuple[FloatMap, FloatMap, FloatMap]:
        """Bilinear value and derivatives (K, B) along x and y per cell, at points u, v (K, B) in cells."""
        u = cells_within(u)
        v = cells_within(v)
        fu = np.floor(u - 0.5)
        fv = np.floor(v - 0.5)
        x = fu.astype(np.int64)
        y = fv.astype(np.int64)
        a = (u - 0.5 - fu).astype(np.float32)
        b = (v - 0.5 - fv).astype(np.float32)
        f00 = self.at(y, x).astype(np.float32)
        f01 = self.at(y, x + 1).astype(np.float32)
        f10 = self.at(y + 1, x).astype(np.float32)
        f11 = self.at(y + 1, x + 1).astype(np.float32)
        low = f00 + a * (f01 - f00)
        high = f10 + a * (f11 - f10)
        slope: FloatMap = (1 - b) * (f01 - f00) + b * (f11 - f10)  # pyright: ignore[reportAssignmentType]
        value: FloatMap = low + b * (high - low)  # pyright: ignore[reportAssignmentType]
        return value, slope, high - low  # pyright: ignore[reportReturnType]


def distances(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    rows: Int32Array,
    poses: FloatArray,
    ends: FloatArray,
    resolution: float,
    reach_cells: float,
    threads: int,
) -> FloatMap:
    """Distance in m (K, B) float32 from points (B, 2) at poses (K, 3) to the nearest occupied cell's centre.

    Interpolated between cells; the field's reach where nothing is nearer.
    """
    scale = 1.0 / resolution
    reach_m = reach_cells * resolution
    x, y = transform_to_world(poses, ends)
    value, _, _ = _Field(roots, first, pages, field, rows).sample(x * scale, y * scale)
    return (reach_m - reach_m / 255.0 * value.astype(np.float64)).astype(np.float32)


def known_cells(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    row: int,
    pose: FloatArray,
    points: FloatArray,
    resolution: float,
) -> NDArray[np.bool_]:
    """Whether something is known of the cells (B,) of map `row` in which points (B, 2) lie, seen from a pose (3,)."""
    x, y = (cells_within(np.floor(at[0] * (1.0 / resolution))) for at in transform_to_world(pose[None], points))
    addresses = cell_addresses(roots, first, pages, row, y.astype(np.int64), x.astype(np.int64))
    return np.asarray(log_odds.reshape(-1)[addresses] != unknown_of(log_odds))


def cast_rays(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    rows: Int32Array,
    poses: FloatArray,
    origin: FloatArray,
    directions: FloatArray,
    resolution: float,
    max_m: float,
    threads: int,
) -> FloatMap:
    """Range in m (K, B) float32 from `origin` (2,) along unit `directions` (B, 2) to the first occupied cell.

    The range is where the ray passes the cell's centre, in [0, `max_m`]; `max_m` where it meets none.

    Source: Amanatides and Woo, A fast voxel traversal algorithm for ray tracing (1987).
    """
    place = np.concatenate(transform_to_world(poses, origin[None]), axis=1)[:, None]
    turned = np.stack(transform_to_world(poses * [0, 0, 1], directions), axis=-1)
    lookup = _Field(roots, first, pages, field, rows)
    near: NDArray[np.bool_] = np.all(np.abs(place[:, 0]) <= FARTHEST * resolution, axis=-1)
    place = np.where(near[:, None, None], place, 0.0)
    cell = np.broadcast_to(np.floor(place * (1.0 / resolution)), turned.shape).astype(np.int64)
    forward = np.where(turned > 0, 1, -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        stride = np.where(turned != 0, resolution / np.abs(turned), np.inf)
        border = np.where(turned != 0, ((cell + (forward > 0)) * resolution - place) / turned, np.inf)
    ranges = np.full(turned.shape[:2], max_m)
    reach = _reach_of_rays(roots.shape[1:], first, place, turned, resolution, max_m)
    k, b = np.nonzero((reach > 0) & near[:, None])
    while len(k):
        here = cell[k, b]
        met = lookup._replace(rows=rows[k]).at(here[:, None, 1], here[:, None, 0])[:, 0] == OCCUPIED
        passes = np.sum(((here + 0.5) * resolution - place[k, 0]) * turned[k, b], axis=1)
        ranges[k[met], b[met]] = np.clip(passes[met], 0.0, max_m)
        k, b = k[~met], b[~met]
        axis = np.where(border[k, b, 0] < border[k, b, 1], 0, 1)
        inside = border[k, b, axis] < reach[k, b]
        k, b, axis = k[inside], b[inside], axis[inside]
        border[k, b, axis] += stride[k, b, axis]
        cell[k, b, axis] += forward[k, b, axis]
    return ranges.astype(np.float32)


_MOST_RAY_CELLS = 1 << 24
"""Of a ray that comes from far away; 840 km in cells of 5 cm."""


def _reach_of_rays(
    pages: tuple[int, ...],
    first: tuple[int, int],
    place: FloatArray,
    turned: FloatArray,
    resolution: float,
    max_m: float,
) -> FloatArray:
    """How far rays (K, B) are followed: to where they have left the tables, beyond which nothing is occupied."""
    side = PAGE * TILE * resolution
    step_m = resolution / np.maximum(np.abs(turned).max(axis=-1), 1e-300)
    reach: FloatArray = np.minimum(max_m, _MOST_RAY_CELLS * step_m)
    for axis, page, count in ((0, first[1], pages[1]), (1, first[0], pages[0])):
        direction = turned[..., axis]
        end = np.where(direction > 0, (page + count + 1) * side, (page - 1) * side)
        with np.errstate(divide="ignore", invalid="ignore"):
            leaves = np.where(direction != 0, (end - place[..., axis]) / direction, np.inf)
        reach = np.minimum(reach, leaves)
    return reach


def match(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    rows: Int32Array,
    guesses: FloatArray,
    priors: FloatArray,
    ends: FloatArray,
    resolution: float,
    max_iterations: int,
    min_ends: int,
    cauchy_cells: float,
    max_step_cells: float,
    max_step_rad: float,
    stop_cells: float,
    stop_rad: float,
    reach_cells: float,
    min_information: float,
    point_to_line: bool,
    threads: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Gauss-Newton of a scan's `ends` (B, 2) on the distance field, from `guesses` (K, 3) with `priors` (K, 3, 3).

    Minimizes sum_b c^2 log(1 + (d_b / c)^2) + e^T P e with d_b the distance and c = `cauchy_cells` in cells, e the way
    from the guess and P its information, in m and rad, by the weights w_b = 1 / (1 + (d_b / c)^2). A step is clipped to
    `max_step_cells` and `max_step_rad`; one below both `stop_cells` and `stop_rad` is the last. Along a direction with
    less information than `min_information` per agreeing beam the guess is held, and with fewer ends than `min_ends`
    altogether. If `point_to_line`, ends on a straight
    wall count only across it, and those in unknown cells whose nearest obstacle lies along their wall rather than
    across are ignored entirely.

    Returns
    -------
    poses : (K, 3) float64
    information : (K, 3, 3) float64
        Of the measurement alone at `poses`: the normal matrix of residuals in m, over m and rad.
    score : (K,) float64
        Sum of the weights at `poses`.

    References
    ----------
    Kohlbrecher et al. 2011, with the residual a distance.
    """
    unit = np.array([resolution, resolution, 1.0])
    prior = priors * unit[:, None] * unit / resolution**2
    guess = guesses / unit
    pose = guess.copy()
    going = np.flatnonzero(np.isfinite(guesses).all(axis=1))
    settings = ends / resolution, _walls(ends * (1 / resolution), point_to_line), cauchy_cells, reach_cells
    for _ in range(max_iterations if len(ends) >= min_ends else 0):
        lookup = _Field(roots, first, pages, field, rows[going])
        h, g, score = _linearize(lookup, log_odds, pose[going], *settings)
        held = prior[going] + _pin_degenerate(h, min_information * score)
        step, solved = _solve(h + held, g + np.einsum("kij,kj->ki", held, pose[going] - guess[going]))
        step, going = step[solved], going[solved]
        length = np.hypot(step[:, 0], step[:, 1])
        shorter = max_step_cells / np.maximum(length, max_step_cells)
        pose[going, :2] -= shorter[:, None] * step[:, :2]
        pose[going, 2] -= np.clip(step[:, 2], -max_step_rad, max_step_rad)
        going = going[(length >= stop_cells) | (np.abs(step[:, 2]) >= stop_rad)]
        if not len(going):
            break
    seen_from = np.where(np.isfinite(pose).all(axis=1, keepdims=True), pose, [FARTHEST, FARTHEST, 0.0])
    h, _, score = _linearize(_Field(roots, first, pages, field, rows), log_odds, seen_from, *settings)
    pose[:, 2] -= 2 * np.pi * np.floor((pose[:, 2] + np.pi) / (2 * np.pi))
    return pose * unit, h * resolution**2 / (unit[:, None] * unit), score


def match_pose(
    roots: Int32Array,
    first: tuple[int, int],
    pages: Int32Array,
    log_odds: LogOdds,
    field: NDArray[np.uint8],
    row: int,
    guess: tuple[float, float, float],
    prior: tuple[float, float, float, float, float, float],
    ends: FloatArray,
    thin_m: float,
    resolution: float,
    max_iterations: int,
    *settings: Any,  # noqa: ANN401 those of `match`
) -> tuple[tuple[float, ...], tuple[float, ...], float, float]:
    """`match` of one `guess` to map `row`, in numbers: pose, information and score, and the score of all ends.

    The `settings` are those of `match`, up to `point_to_line`. Of the symmetric matrices `prior` and information the
    upper triangle, row by row. Of successive ends in a square of the side `thin_m` the first alone is matched; where
    that is 0, each is.
    """
    upper = np.triu_indices(3)
    whole = np.zeros((3, 3))
    whole[upper] = whole.T[upper] = prior
    maps = roots, first, pages, log_odds, field, np.array([row], np.int32)

    def match_from(begin: FloatArray, points: FloatArray, passes: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        given: list[Any] = [*maps, begin, whole[None], points, resolution, passes, *settings, 1]
        return match(*given)

    kept = ends
    if thin_m > 0:
        squares = np.floor(ends / thin_m)
        kept = ends[np.append(len(ends) > 0, (squares[1:] != squares[:-1]).any(axis=1))[: len(ends)]]
    poses, information, score = match_from(np.array([guess]), kept, max_iterations)
    agreeing = match_from(poses, ends, 0)[2] if thin_m > 0 else score
    numbers = tuple(poses[0].tolist()), tuple(information[0][upper].tolist())
    return *numbers, float(score[0]), float(agreeing[0])


def _linearize(
    lookup: _Field,
    log_odds: LogOdds,
    poses: FloatArray,
    ends: FloatArray,
    walls: FloatMap,
    cauchy_cells: float,
    reach_cells: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal matrix (K, 3, 3), gradient (K, 3) and sum of the weights (K,) at `poses` (K, 3), all in cells."""
    u, v = transform_to_world(poses, ends)
    value, du, dv = lookup.sample(u, v)
    to_cells = reach_cells / 255.0
    d = reach_cells - to_cells * value.astype(np.float64)
    gradient = -to_cells * np.stack([du, dv], axis=-1).astype(np.float64)
    c = np.cos(poses[:, 2])
    s = np.sin(poses[:, 2])
    normals = walls @ np.stack([c, s, -s, c], axis=-1).reshape(-1, 2, 2)
    slope = (gradient * normals).sum(axis=-1, keepdims=True)
    beyond = (normals**2).sum(axis=-1) * (gradient**2).sum(axis=-1) > _BEYOND * slope[..., 0] ** 2
    cells = np.floor(cells_within(np.array([v, u]))).astype(np.int64)
    beyond &= log_odds.reshape(-1)[lookup.cell_addresses(*cells)] == unknown_of(log_odds)
    constraining = np.where((normals**2).sum(axis=-1, keepdims=True) > 0, slope * normals, gradient)
    ju, jv = np.moveaxis(np.where(beyond[..., None], 0.0, constraining), -1, 0)
    jacobian = np.stack([ju, jv, jv * (u - poses[:, :1]) - ju * (v - poses[:, 1:2])], axis=-1)
    weight = 1.0 / (1.0 + (d / cauchy_cells) ** 2)
    weighted = jacobian.transpose(0, 2, 1) * weight[:, None]
    return weighted @ jacobian, (weighted @ d[..., None])[..., 0], weight.sum(axis=1)


def _walls(ends: FloatArray, point_to_line: bool) -> FloatMap:
    """Normals (B, 2) of the straight walls on which ends (B, 2) lie, in cells; 0 on none, or not `point_to_line`.

    An end lies on a wall where three ends that are equally many beams apart, such that `_BASE` cells would lie between
    them were all as far apart as here, follow one another along a line to 0.6 cells. The end is the middle one of the
    three; else, at the end of a wall, the last; else the first. All is in single precision, so that the kernel decides
    alike.
    """
    at = ends.astype(np.float32)
    normals = np.zeros_like(at)
    if not point_to_line or len(ends) < 3:
        return normals
    steps = np.diff(at, axis=0)
    between = np.sqrt((steps * steps).sum(axis=1))
    apart = np.maximum(np.append(np.float32(0), between), np.append(between, np.float32(0)))
    left = np.arange(len(at))
    for first in (-1, -2, 0):
        with np.errstate(divide="ignore", over="ignore"):
            stride = np.ceil(np.minimum(_BASE / apart[left], np.float32(len(ends)))).astype(np.int64)
        a, m, b = (left + (first + k) * stride for k in range(3))
        inside = (a >= 0) & (b < len(ends))
        i, a, m, b = left[inside], a[inside], m[inside], b[inside]
        u = at[m] - at[a]
        v = at[b] - at[m]
        chord = u + v
        length = np.sqrt((chord * chord).sum(axis=1))
        straight = (u * v).sum(axis=1) > 0
        straight &= np.abs(u[:, 0] * chord[:, 1] - u[:, 1] * chord[:, 0]) <= _ASIDE * length
        normals[i[straight]] = np.stack([-chord[:, 1], chord[:, 0]], axis=1)[straight] / length[straight, None]
        left = np.setdiff1d(left, i[straight])
    return normals


def _pin_degenerate(h: FloatArray, least: FloatArray) -> FloatArray:
    """Information (K, 3, 3) that pins the position where its own, the heading marginalized, is below `least` (K,)."""
    turn = np.where(h[:, 2, 2] > 0, h[:, 2, 2], np.inf)[:, None, None]
    position = h[:, :2, :2] - h[:, :2, 2, None] * h[:, 2, None, :2] / turn
    strengths, directions = np.linalg.eigh(position)
    held = np.zeros_like(h)
    pins = _PIN * (strengths < least[:, None])
    held[:, :2, :2] = np.einsum("kij,kj,klj->kil", directions, pins, directions)
    return held


def _solve(h: FloatArray, g: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Steps (K, 3) that solve h step = g, and whether each h (K, 3, 3) is positive definite; 0 where it is not."""
    solved = np.linalg.eigvalsh(h)[:, 0] > _SINGULAR
    step = np.zeros_like(g)
    step[solved] = np.linalg.solve(h[solved], g[solved, :, None])[..., 0]
    return step, solved


_AT_ONCE = 1 << 20  # look-ups: some 50 MB of intermediate arrays


def sum_at_ends(
    patches: NDArray[np.uint32],
    corner: FloatArray,
    resolution: float,
    poses: FloatArray,
    ends: FloatArray,
    threads: int,
) -> FloatArray:
    """Sum over beams of a field at their ends (B, 2), seen from poses (K, 3): (K,) float64.

    The field, 0 to 255, is known at the centres of cells, the first of which has its lower left corner at `corner`
    (2,), and bilinear between them. A patch (H, W) holds four of its values in a word: the cell's own, those of the
    cells to its right, above, and above to the right, from the least significant byte on. What lies beyond takes the
    value of the nearest cell at the border, so the caller puts there what is to hold outside.
    """
    some = max(_AT_ONCE // max(len(ends), 1), 1)
    parts = [_sum_some(patches, corner, resolution, poses[k : k + some], ends) for k in range(0, len(poses), some)]
    return np.concatenate(parts) if parts else np.zeros(0)


def _sum_some(
    patches: NDArray[np.uint32], corner: FloatArray, resolution: float, poses: FloatArray, ends: FloatArray
) -> FloatArray:
    rows, columns = patches.shape
    x, y = transform_to_world(poses, ends)
    u = np.clip((x - corner[0]) / resolution - 0.5, 0, np.nextafter(columns, 0))
    v = np.clip((y - corner[1]) / resolution - 0.5, 0, np.nextafter(rows, 0))
    column = u.astype(np.int64)
    row = v.astype(np.int64)
    a = u - column
    b = v - row
    patch = patches[row, column]
    f00, f01, f10, f11 = ((patch >> shift & 255).astype(np.float64) for shift in (0, 8, 16, 24))
    low = f00 + a * (f01 - f00)
    high = f10 + a * (f11 - f10)
    return np.asarray((low + b * (high - low)).sum(axis=1))


Bytes = NDArray[np.uint8]

_TOP = 16  # cells a side of the largest squares whose greatest value is known
_STRIP = 32  # zeros before each row of these


def max_pyramid(field: Bytes, ids: Int32Array, likelihood: Bytes) -> tuple[Bytes, Bytes, Bytes]:
    """A map's likelihoods, and the greatest of each square of 8 x 8 and of 16 x 16 cells.

    Parameters
    ----------
    field : (T, 32, 32) uint8
        Tiles of distances.
    ids : (R, C) int32
        Of the tiles of the map.
    likelihood : (256,) uint8
        Of each distance.

    Returns
    -------
    cells, nodes : (H, W) uint8
        The likelihoods in a frame of 16 zeros, H = 32 R + 32, W = 32 C + 32; and the greatest of each 8 x 8 cells that
        begin at a framed cell.
    top : (16, 16, H / 16 + 1, 32 + W / 16) uint8
        [y mod 16, x mod 16, y / 16, 32 + x / 16] is the greatest of the 16 x 16 that begin at framed cell (y, x). The
        last row and the first 32 columns are 0.

    References
    ----------
    Hess et al., Real-time loop closure in 2D lidar SLAM (ICRA 2016), precomputed grids.
    """
    tiles = likelihood[field[ids]].swapaxes(1, 2)
    cells = np.pad(tiles.reshape(tiles.shape[0] * tiles.shape[1], -1), _TOP)
    height, width = cells.shape
    squares = [np.pad(cells, ((0, _TOP), (0, _TOP)))]
    for step in (1, 2, 4, 8):
        wide = np.maximum(squares[-1][:, :-step], squares[-1][:, step:])
        squares.append(np.maximum(wide[:-step], wide[step:]))
    nodes, largest = (np.ascontiguousarray(squares[k][:height, :width]) for k in (3, 4))
    split = largest.reshape(height // _TOP, _TOP, width // _TOP, _TOP).transpose(1, 3, 0, 2)
    return cells, nodes, np.ascontiguousarray(np.pad(split, ((0, 0), (0, 0), (0, 1), (_STRIP, 0))))


def correlate(
    cells: Bytes,
    nodes: Bytes,
    top: Bytes,
    ends: FloatArray,
    headings: FloatArray,
    window: tuple[int, int, int, int],
    centre: FloatArray,
    information: FloatArray,
    distance: float,
    count: int,
    min_sum: int,
    min_runner_up_ratio: float,
    min_distance_cells: float,
    min_distance_rad: float,
) -> Int32Array:
    """The best lattice pose of a scan in a map, and the best ones that are other places.

    A lattice pose is the centre of a cell (x, y) with x0 <= x < x1 and y0 <= y < y1, and one of `headings` (A,). Its
    sum adds the likelihood of the cells that hold the scan's `ends`; of equal sums the first by (heading, y, x) is the
    better. Only poses whose way d from `centre` (3,) has d^T `information` d <= `distance`^2 are tried.

    Parameters
    ----------
    cells, nodes, top : arrays of `max_pyramid`
    ends : (B, 2) float64, cells
        From the scan's origin, B <= 256.
    window : (int, int, int, int)
        x0, x1, y0, y1: cells of the map.
    centre, information : (3,), (3, 3) float64
        In cells and rad, from the lower left corner of the map's cell (0, 0); headings are taken as they are given.
    count, min_sum : int
        How many places are wanted, and the least sum of each.
    min_runner_up_ratio : float
        Least part of the first place's sum that the others must have.
    min_distance_cells, min_distance_rad : float
        A pose within both of an earlier place is not another one.

    Returns
    -------
    (N, 4) int32
        [sum, heading's index, y, x] of at most `count` places, the best first.

    References
    ----------
    Olson, Real-time correlative scan matching (ICRA 2009); Hess et al. 2016, Algorithm 3, of which the
    compiled twin is the best-first form.
    """
    poses = [np.zeros((0, 4), np.int64)]
    for index, heading in enumerate(headings.tolist()):
        sums = np.where(
            _within(window, heading, centre, information, distance), _sums(cells, ends, heading, window), -1
        )
        y, x = np.nonzero(sums >= max(min_sum, 0))
        poses.append(np.column_stack([sums[y, x], np.full(len(y), index), y + window[2], x + window[0]]))
    left = np.concatenate(poses)
    left = left[np.argsort(-left[:, 0], kind="stable")]
    found: list[IntArray] = []
    while len(left) and len(found) < count:
        place = left[0]
        found.append(place)
        turns = np.array([abs(math.remainder(h - headings[place[1]], 2 * math.pi)) for h in headings.tolist()])
        squared = ((left[:, 2:] - place[2:]) ** 2).sum(axis=1)
        other = (turns[left[:, 1]] > min_distance_rad) | (squared > min_distance_cells**2)
        left = left[other & (left[:, 0] >= min_runner_up_ratio * found[0][0])]
    return np.array(found, dtype=np.int32).reshape(-1, 4)


def _sums(cells: Bytes, ends: FloatArray, heading: float, window: tuple[int, int, int, int]) -> IntArray:
    """Sums (y1 - y0, x1 - x0) of the window's poses with one heading."""
    (x0, x1, y0, y1) = window
    likelihood = cells[_TOP:-_TOP, _TOP:-_TOP]
    height, width = likelihood.shape
    c = math.cos(heading)
    s = math.sin(heading)
    dx = np.floor(c * ends[:, 0] - s * ends[:, 1] + 0.5).astype(np.int64)
    dy = np.floor(s * ends[:, 0] + c * ends[:, 1] + 0.5).astype(np.int64)
    sums = np.zeros((y1 - y0, x1 - x0), np.int64)
    for x, y in zip(dx.tolist(), dy.tolist(), strict=True):
        # The poses from which this end lies inside the map
        left = max(x0, -x)
        right = min(x1, width - x)
        low = max(y0, -y)
        high = min(y1, height - y)
        if left < right and low < high:
            sums[low - y0 : high - y0, left - x0 : right - x0] += likelihood[low + y : high + y, left + x : right + x]
    return sums


def _within(
    window: tuple[int, int, int, int], heading: float, centre: FloatArray, information: FloatArray, distance: float
) -> NDArray[np.bool_]:
    """Which of the window's poses (y1 - y0, x1 - x0) with one heading are within `distance` of `centre`."""
    x0, x1, y0, y1 = window
    away = np.empty((y1 - y0, x1 - x0, 3))
    away[..., 0] = np.arange(x0, x1) + 0.5 - centre[0]
    away[..., 1] = (np.arange(y0, y1) + 0.5 - centre[1])[:, None]
    away[..., 2] = heading - centre[2]
    return np.asarray(np.einsum("yxi,ij,yxj->yx", away, information, away) <= distance * distance)
