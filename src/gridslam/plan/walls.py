"""Walls: faces in one line joined, and two faces back to back made one wall with its thickness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from gridslam.plan.faces import Face
from gridslam.plan.rasters import BoolArray, Raster
from gridslam.plan.segments import Segments
from gridslam.plan.untyped import connected_components, coo_matrix, require_map_extra, spatial
from gridslam.types import FloatArray, IntArray

_PARALLEL_RAD = np.deg2rad(3)
_SAME_LINE_M = 0.05
_WIDEST_HIDDEN_M = 2.5
"""Along a wall furniture hides at most this much of it, and is no longer itself."""
_THICKEST_M = 0.45
_THINNEST_M = 0.03
_LEAST_OVERLAP_M = 0.15
_REACH_M = 0.3
"""One face of a wall may end this much before the other: at a corner, by the thickness of the next wall."""
_SHORTEST_M = 0.3
_LONGEST_FURNITURE_M = 3.6
_DEEPEST_FURNITURE_M = 1.5
_SHALLOWEST_FURNITURE_M = 0.2
_CORNER_M = 0.35
_SHORT_M = 2.0
_CLUTTER_M = 0.2
_CLUTTER_RAD = np.deg2rad(10)
_SHORTEST_ALONE_M = 0.6
_BESIDE_M = 1.0
_SQUARE_RAD = np.deg2rad(20)
_NONE = np.zeros((0, 2), np.int64)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """A straight piece of wall.

    Attributes
    ----------
    ends : (2, 2) float64, m
        Of the centre line; of the seen face where only one was seen. What was seen of it lies to the left.
    thickness_m : float or None
        None where only one side was seen.
    """

    ends: FloatArray
    thickness_m: float | None

    @property
    def length_m(self) -> float:
        """Length of the piece."""
        return float(np.hypot(*(self.ends[1] - self.ends[0])))

    @property
    def outline(self) -> FloatArray:
        """Corners (4, 2), anticlockwise, of the wall; without thickness both long sides are the face."""
        along = (self.ends[1] - self.ends[0]) / max(self.length_m, 1e-9)
        half = 0.5 * (self.thickness_m or 0.0) * np.array([-along[1], along[0]])
        return np.array([self.ends[0] - half, self.ends[1] - half, self.ends[1] + half, self.ends[0] + half])


def join_faces(faces: Sequence[Face], raster: Raster) -> list[Face]:
    """Join collinear faces without free space between them, as behind furniture."""
    left = sorted(faces, key=lambda face: -face.length_m)
    segments = Segments.of(np.array([face.ends for face in left]))
    is_left = np.ones(len(left), np.bool_)
    joined: list[Face] = []
    for k, face in enumerate(left):
        if not is_left[k]:
            continue
        is_left[k] = False
        while (number := _find_continuation(face, segments, is_left, raster)) is not None:
            is_left[number] = False
            face = _unite(face, left[number])
        joined.append(face)
    return joined


def _find_continuation(face: Face, segments: Segments, is_left: BoolArray, raster: Raster) -> int | None:
    """Number of the first face that is left in the line of this one, with nothing free between them."""
    numbers, segments = segments.near(face.ends, _WIDEST_HIDDEN_M)
    steps, offsets = segments.locate(face.middle, face.along)
    fits = is_left[numbers] & (segments.alongs @ face.along > np.cos(2 * _PARALLEL_RAD))
    fits &= np.abs(offsets).max(axis=1, initial=0.0) < _SAME_LINE_M
    before, after = face.begin - steps.max(axis=1, initial=-np.inf), steps.min(axis=1, initial=np.inf) - face.end
    fits &= np.maximum(before, after) < _WIDEST_HIDDEN_M
    for k in np.flatnonzero(fits).tolist():
        gap = max(before[k], after[k])
        begin = face.end if after[k] > before[k] else face.begin - gap
        places = begin + np.linspace(0, gap, max(2, int(gap / raster.cell_m) + 1))
        hidden = np.asarray(face.middle + np.outer(places, face.along) - 0.02 * face.normal, np.float64)
        if gap <= 0 or raster.share_free(hidden) < 0.3:
            return int(numbers[k])
    return None


def drop_clutter(faces: Sequence[Face]) -> list[Face]:
    """Leave out short faces close in front of or behind a longer one, and those of less than 60 cm that touch none."""
    segments = Segments.of(np.array([face.ends for face in faces]))
    kept = []
    for k, face in enumerate(faces):
        numbers, near = segments.near(face.ends, _CORNER_M)
        steps, offsets = near.locate(face.middle, face.along)
        longer = near.lengths > 2 * face.length_m
        beside = longer & (near.alongs @ face.along > np.cos(_CLUTTER_RAD))
        beside &= (np.abs(offsets.mean(axis=1)) < _CLUTTER_M) & (steps.min(axis=1) < face.begin + 0.2 * face.length_m)
        beside &= steps.max(axis=1) > face.end - 0.2 * face.length_m
        touching = (near.distances(face.ends).min(axis=0) < _CORNER_M) & (numbers != k)
        if not beside.any() and (face.length_m >= _SHORTEST_ALONE_M or touching.any()):
            kept.append(face)
    return kept


def _unite(long: Face, short: Face) -> Face:
    """Fit one face through both: about the long one, turned and shifted by the weight of the short one."""
    ends = np.concatenate([long.ends, short.ends])
    share = np.repeat([long.weight, short.weight], 2)
    middle = np.average(ends, axis=0, weights=share)
    _, axes = np.linalg.eigh(((ends - middle) * share[:, None]).T @ (ends - middle))
    along = axes[:, 1] if axes[:, 1] @ long.along > 0 else -axes[:, 1]
    steps = (ends - middle) @ along
    direction = float(np.arctan2(along[1], along[0]))
    return Face(middle, direction, float(steps.min()), float(steps.max()), long.weight + short.weight)


def find_furniture_faces(faces: Sequence[Face], raster: Raster) -> tuple[BoolArray, list[FloatArray]]:
    """Which faces (F,) are furniture's, and outlines (K, 2) of that which stands against a wall.

    Furniture stands alone (see `Raster.furniture`); or is a short face in front of a longer one; or two short faces
    that meet at a corner which protrudes, without another side of a wall behind them.
    """
    segments = Segments.of(np.array([face.ends for face in faces]))
    is_furniture = np.array([raster.is_furniture(face.middle - 0.06 * face.normal) for face in faces], np.bool_)
    has_back = np.array([bool(_find_backs(face, segments)) for face in faces], np.bool_)
    is_short = (segments.lengths < _LONGEST_FURNITURE_M) & ~has_back & ~is_furniture
    outlines = []
    for group in _find_protruding(segments, np.flatnonzero(is_short & (segments.lengths < _WIDEST_HIDDEN_M))):
        is_furniture[group] = True
        outlines.append(_enclose(segments.ends[group].reshape(-1, 2), segments.alongs[group[0]]))
    for k in np.flatnonzero(is_short & ~is_furniture).tolist():
        depth = _depth_before_wall(k, segments, ~is_furniture)
        if depth is not None and _is_solid(faces[k], depth, raster):
            is_furniture[k] = True
            outlines.append(np.concatenate([faces[k].ends, faces[k].ends - depth * faces[k].normal]))
    return is_furniture, [hull(outline) for outline in outlines]


def _find_protruding(segments: Segments, chosen: IntArray) -> list[IntArray]:
    """Groups of the chosen segments, by their numbers, that meet at square corners which protrude."""
    ends, normals = segments.ends[chosen], segments.normals[chosen]
    pairs = spatial.cKDTree(ends.reshape(-1, 2)).query_pairs(_CORNER_M, output_type="ndarray") if len(chosen) else _NONE
    (first, here), (second, there) = (pairs[:, 0] // 2, pairs[:, 0] % 2), (pairs[:, 1] // 2, pairs[:, 1] % 2)
    outward = ((ends[second, 1 - there] - ends[first, here]) * normals[first]).sum(axis=1) < 0
    outward |= ((ends[first, 1 - here] - ends[second, there]) * normals[second]).sum(axis=1) < 0
    meets = outward & (np.abs((normals[first] * normals[second]).sum(axis=1)) < np.sin(_SQUARE_RAD))
    graph = coo_matrix((np.ones(meets.sum(), np.bool_), (first[meets], second[meets])), (len(chosen),) * 2)
    _, labels = connected_components(graph, directed=False)
    groups = [chosen[labels == label] for label in np.unique(labels)]
    return [group for group in groups if len(group) > 1]


def _enclose(points: FloatArray, along: FloatArray) -> FloatArray:
    """Corners (4, 2) of the rectangle about points (N, 2) whose sides are along a direction and across it."""
    axes = np.array([along, [-along[1], along[0]]])
    turned = points @ axes.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    return np.asarray(np.array([low, (high[0], low[1]), high, (low[0], high[1])]) @ axes)


def hull(points: FloatArray) -> FloatArray:
    """Corners (K, 2) of the convex hull of points (N, 2), which are not all in one line, anticlockwise."""
    _, shapely = require_map_extra()
    polygon = shapely.geometry.polygon.orient(shapely.convex_hull(shapely.MultiPoint(points)))
    return np.array(polygon.exterior.coords)[:-1]


def _depth_before_wall(k: int, segments: Segments, is_wall: BoolArray) -> float | None:
    """How far behind a face the nearest wall is that faces the same way; None if there is none.

    It must be longer than the face, or be seen on both sides of it; beside a short face one side is enough.
    """
    length = segments.lengths[k]
    numbers, near = segments.near(segments.ends[k], 2 * _DEEPEST_FURNITURE_M)
    steps, offsets = near.locate(segments.ends[k, 0], segments.alongs[k])
    depths = -offsets.mean(axis=1)
    behind = is_wall[numbers] & (near.alongs @ segments.alongs[k] > np.cos(_PARALLEL_RAD))
    behind &= (depths > _SHALLOWEST_FURNITURE_M) & (depths < _DEEPEST_FURNITURE_M)
    behind &= (steps.min(axis=1) < length + _BESIDE_M) & (steps.max(axis=1) > -_BESIDE_M)
    if length > _SHORT_M and not (behind & (near.lengths > length)).any():
        sides = (steps[behind].min(initial=0) < 0) and (steps[behind].max(initial=0) > length)
        return float(depths[behind].min()) if sides else None
    return float(depths[behind].min()) if behind.any() else None


def _is_solid(face: Face, depth: float, raster: Raster) -> bool:
    """Return whether nothing free is seen behind a face."""
    along = np.linspace(face.begin + 0.1, face.end - 0.1, 10)
    across = np.linspace(0.1, depth - 0.1, 5)
    places = face.middle + along[:, None, None] * face.along - across[None, :, None] * face.normal
    return raster.share_free(places.reshape(-1, 2)) < 0.2


def close_corners(walls: Sequence[Wall]) -> list[Wall]:
    """Lengthen walls that end up to 35 cm before the middle of another one that crosses their direction."""
    segments = Segments.of(np.array([wall.ends for wall in walls]))
    closed = []
    for k, wall in enumerate(walls):
        ends = wall.ends.copy()
        _, near = segments.near(ends, 2 * _CORNER_M)
        for end, along in ((0, -segments.alongs[k]), (1, segments.alongs[k])):
            steps, offsets = near.locate(ends[end], along)
            crossing = np.abs(near.normals @ along) > np.sin(np.pi / 4)
            crossing &= (offsets.min(axis=1) < _CORNER_M) & (offsets.max(axis=1) > -_CORNER_M)
            slopes = (steps[:, 1] - steps[:, 0]) / np.where(crossing, offsets[:, 1] - offsets[:, 0], 1.0)
            meetings = (steps[:, 0] - offsets[:, 0] * slopes)[crossing]
            meetings = meetings[(meetings > 0) & (meetings < _CORNER_M)]
            ends[end] += meetings.min(initial=np.inf) * along if len(meetings) else 0.0
        closed.append(Wall(ends, wall.thickness_m))
    return closed


def make_walls(faces: Sequence[Face]) -> list[Wall]:
    """Pair faces back to back, 3 to 45 cm apart, the longest overlaps first; the others are walls of one face."""
    segments = Segments.of(np.array([face.ends for face in faces]))
    covered: list[list[tuple[float, float]]] = [[] for _ in faces]
    pairs = [(a, *back) for a, face in enumerate(faces) for back in _find_backs(face, segments) if back[0] < a]
    walls = []
    for a, b, _, begin, end, thickness in sorted(pairs, key=lambda pair: -pair[2]):
        face, other = faces[a], faces[b]
        free = _subtract([(begin, end)], covered[a])
        if sum(last - first for first, last in free) < 0.5 * (end - begin):
            continue
        steps, _ = other.locate(face.middle + np.outer([begin, end], face.along))
        covered[a].append((begin, end))
        covered[b].append((float(steps.min()), float(steps.max())))
        ends = face.middle + np.outer([begin, end], face.along) - 0.5 * thickness * face.normal
        walls.append(Wall(ends, thickness))
    for face, parts in zip(faces, covered, strict=True):
        for begin, end in _subtract([(face.begin, face.end)], parts):
            if end - begin >= _SHORTEST_M:
                walls.append(Wall(face.middle + np.outer([begin, end], face.along), None))
    return walls


def _find_backs(face: Face, segments: Segments) -> list[tuple[int, float, float, float, float]]:
    """Faces back to back with this one: number, overlap, begin and end of the wall along it, and its thickness."""
    numbers, segments = segments.near(face.ends, _THICKEST_M)
    steps, offsets = segments.locate(face.middle, face.along)
    low, high = np.maximum(face.begin, steps.min(axis=1)), np.minimum(face.end, steps.max(axis=1))
    opposite = segments.alongs @ face.along < -np.cos(_PARALLEL_RAD)
    slopes = (offsets[:, 1] - offsets[:, 0]) / np.where(opposite, steps[:, 1] - steps[:, 0], 1.0)
    thickness = -(offsets[:, 0] + slopes * ((low + high) / 2 - steps[:, 0]))
    fits = opposite & (high - low >= _LEAST_OVERLAP_M)
    fits &= (thickness >= _THINNEST_M) & (thickness <= _THICKEST_M)
    begins = np.maximum(low - _REACH_M, np.minimum(face.begin, steps.min(axis=1)))
    ends = np.minimum(high + _REACH_M, np.maximum(face.end, steps.max(axis=1)))
    rows = np.column_stack([high - low, begins, ends, thickness])
    return [(int(numbers[k]), *rows[k].tolist()) for k in np.flatnonzero(fits)]


def _subtract(parts: list[tuple[float, float]], taken: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the rest of intervals without others."""
    for low, high in taken:
        parts = [
            piece
            for begin, end in parts
            for piece in ((begin, min(end, low)), (max(begin, high), end))
            if piece[1] > piece[0]
        ]
    return parts
