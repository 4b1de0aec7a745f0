"""Arcs: round walls, found among surface points where one circle explains more of them than any line."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from gridslam.plan.faces import GAP_M, LEAST_COSINE, OFFSET_M, Face, choose_seed
from gridslam.plan.rasters import BoolArray
from gridslam.plan.surfaces import SurfacePoints
from gridslam.plan.untyped import spatial
from gridslam.types import FloatArray, IntArray

_FEWEST = 8
_ROUNDS = 6
_LEAST_TURN = 0.05
_MOST_TURN = 0.9
"""Between the normals of two faces of one round wall: the distance of their ends."""
_MOST_MISS = 0.15
"""Between the centres of the circles of two faces, as a share of the radius."""
_RADII_M = 0.4, 25.0
_SHORTEST_M = 2.0
_SHORTEST_FACE_M = 0.4
"""Of the smallest circle a chord is longer that is nowhere 5 cm off it."""
_LEAST_SAGITTA_M = 0.15
"""Three times as far from its chord as points may lie from a line."""
_MOST_RMS_M = 0.025
_MOST_RMS_RAD = np.deg2rad(5)
"""Normals, rms: those of a bay of straight sides turn by more between its corners."""
_GAIN = 1.5
"""Weight of the points on an arc, as a ratio to those on the best line."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Arc:
    """A round surface, seen from one side.

    Attributes
    ----------
    centre : (2,) float64, m
    radius_m : float
    begin, end : float, rad
        Directions of its ends from the centre, anticlockwise; begin < end <= begin + 2 pi.
    is_concave : bool
        Whether it was seen from inside.
    """

    centre: FloatArray
    radius_m: float
    begin: float
    end: float
    is_concave: bool

    @property
    def length_m(self) -> float:
        """Length along the arc."""
        return self.radius_m * (self.end - self.begin)

    def halves(self) -> list[Arc]:
        """Return the arc, or both halves of one of more than half a circle."""
        if self.end - self.begin <= np.pi:
            return [self]
        middle = (self.begin + self.end) / 2
        return [replace(self, end=middle), replace(self, begin=middle)]

    def points(self, sagitta_m: float) -> FloatArray:
        """Points (K, 2), m, on the arc from begin to end; chords between them are at most so far from it."""
        step = 2 * np.arccos(max(0.5, 1 - sagitta_m / self.radius_m))
        angles = np.linspace(self.begin, self.end, 1 + max(1, int(np.ceil((self.end - self.begin) / step))))
        return np.asarray(self.centre + self.radius_m * np.column_stack([np.cos(angles), np.sin(angles)]))

    def outline(self, sagitta_m: float) -> FloatArray:
        """Corners (K, 2), m, along the arc there and back: the chord between its ends is no wall."""
        corners = self.points(sagitta_m)
        return np.concatenate([corners, corners[::-1]])

    def faces(self, sagitta_m: float = 0.02) -> list[Face]:
        """Chords as straight faces, free space to their left."""
        corners = self.points(sagitta_m)
        corners = corners if self.is_concave else corners[::-1]
        steps = np.diff(corners, axis=0)
        middles = corners[:-1] + steps / 2
        halves = np.hypot(*steps.T) / 2
        return [
            Face(middle, float(np.arctan2(step[1], step[0])), -half, half, 1.0)
            for middle, step, half in zip(middles, steps, halves.tolist(), strict=True)
        ]

    def turn(self, angle_rad: float) -> Arc:
        """Turn the arc about the origin of the map, anticlockwise."""
        c, s = np.cos(angle_rad), np.sin(angle_rad)
        centre = self.centre @ np.array([[c, s], [-s, c]])
        return replace(self, centre=centre, begin=self.begin + angle_rad, end=self.end + angle_rad)


def find_arcs(points: SurfacePoints, faces: Sequence[Face]) -> tuple[list[Arc], BoolArray]:
    """Find arcs of 2 m and more in a connected surface, where its faces turn; and which points (N,) are on none."""
    arcs: list[Arc] = []
    is_left = np.ones(len(points), np.bool_)
    for centre, radius, sign in _guess_circles(faces):
        numbers = np.flatnonzero(is_left)
        found = _grow(points.select(numbers), centre, radius, sign)
        if found is not None:
            arcs.append(found[0])
            is_left[numbers[found[1]]] = False
    return arcs, is_left


def _guess_circles(faces: Sequence[Face]) -> Iterator[tuple[FloatArray, float, float]]:
    """Yield centre, radius and side, -1 inside and 1 outside, of the circle on each two faces that meet and turn."""
    faces = sorted((face for face in faces if face.length_m >= _SHORTEST_FACE_M), key=lambda face: -face.length_m)
    if len(faces) < 2:
        return
    ends = np.array([face.ends for face in faces]).reshape(-1, 2)
    pairs = spatial.cKDTree(ends).query_pairs(GAP_M, output_type="ndarray")
    for first, second in np.unique(np.sort(pairs // 2, axis=1), axis=0).tolist():
        apart = faces[first].ends.mean(axis=0) - faces[second].ends.mean(axis=0)
        turned = faces[first].normal - faces[second].normal
        squared = float(turned @ turned)
        if not _LEAST_TURN**2 < squared < _MOST_TURN**2:
            continue
        radius = float(apart @ turned) / squared  # positive outside
        middles = np.array([faces[k].ends.mean(axis=0) for k in (first, second)])
        centres = middles - radius * np.array([faces[k].normal for k in (first, second)])
        miss = float(np.hypot(*(centres[1] - centres[0])))
        if miss < _MOST_MISS * abs(radius) and _RADII_M[0] <= abs(radius) <= _RADII_M[1]:
            yield centres.mean(axis=0), abs(radius), float(np.sign(radius))


def _grow(points: SurfacePoints, centre: FloatArray, radius: float, sign: float) -> tuple[Arc, IntArray] | None:
    """Fit a circle to the points that agree with it, again and again; None where a line has nearly as many."""
    on_it, begin, end = np.zeros(0, np.int64), 0.0, 0.0
    for _ in range(_ROUNDS):
        before, (radial, apart) = on_it, _locate(points, centre)
        cosines = sign * np.einsum("ij,ij->i", radial, points.normals)
        on_it = np.flatnonzero((np.abs(apart - radius) < OFFSET_M) & (cosines > LEAST_COSINE))
        if len(on_it) < _FEWEST:
            return None
        run, begin, end = _run_about(np.arctan2(radial[on_it, 1], radial[on_it, 0]), GAP_M / radius)
        if radius * (end - begin) < _SHORTEST_M / 2:
            return None
        on_it = on_it[run]
        if np.array_equal(before, on_it):
            break
        centre, radius = _fit_circle(points.positions[on_it], points.weights[on_it], centre, radius)
        if not _RADII_M[0] <= radius <= _RADII_M[1]:
            return None
    chosen = points.select(on_it)
    radial, apart = _locate(chosen, centre)
    turns = np.arccos((sign * np.einsum("ij,ij->i", radial, chosen.normals)).clip(-1, 1))
    rms_m, rms_rad = (np.sqrt(np.average(off**2, weights=chosen.weights)) for off in (apart - radius, turns))
    sagitta = radius * (1 - np.cos(min(end - begin, 2 * np.pi) / 2))
    is_arc = radius * (end - begin) >= _SHORTEST_M and sagitta >= _LEAST_SAGITTA_M
    is_arc &= rms_m <= _MOST_RMS_M and rms_rad <= _MOST_RMS_RAD
    if not is_arc or chosen.weights.sum() < _GAIN * choose_seed(chosen)[1]:
        return None
    radial, apart = _locate(points, centre)
    is_taken = (np.arctan2(radial[:, 1], radial[:, 0]) - begin) % (2 * np.pi) <= end - begin
    is_taken &= np.abs(apart - radius) < 2 * OFFSET_M  # of a doubled wall both
    return Arc(centre, radius, begin, end, sign < 0), np.flatnonzero(is_taken)


def _locate(points: SurfacePoints, centre: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors (N, 2) from a centre to points, and their distances (N,)."""
    radial = points.positions - centre
    apart = np.maximum(np.hypot(*radial.T), 1e-9)
    return radial / apart[:, None], apart


def _run_about(angles: FloatArray, gap_rad: float) -> tuple[IntArray, float, float]:
    """Of directions (N,) the numbers of those in the longest run without a gap, where it begins and where it ends."""
    order = np.argsort(angles)
    gaps = np.diff(angles[order], append=angles[order[0]] + 2 * np.pi)
    cuts = np.flatnonzero(gaps > gap_rad)
    if not len(cuts):
        begin = float(angles[order[0]])
        return order, begin, begin + 2 * np.pi
    order = np.roll(order, -cuts[0] - 1)
    bounds = np.concatenate([[0], np.sort((cuts - cuts[0] - 1) % len(order)) + 1])
    most = int(np.argmax(np.diff(bounds)))
    run = order[bounds[most] : bounds[most + 1]]
    begin = float(angles[run[0]])
    return run, begin, begin + float((angles[run[-1]] - begin) % (2 * np.pi))


def _fit_circle(
    positions: FloatArray, weights: FloatArray, centre: FloatArray, radius: float
) -> tuple[FloatArray, float]:
    """Centre and radius of the circle that is nearest to points, by Gauss-Newton steps from a first guess."""
    for _ in range(3):
        radial = positions - centre
        apart = np.hypot(*radial.T)
        rows = np.column_stack([radial / np.maximum(apart, 1e-9)[:, None], np.ones(len(apart))])
        roots = np.sqrt(weights)
        step, *_ = np.linalg.lstsq(rows * roots[:, None], (apart - radius) * roots, rcond=None)
        centre, radius = centre + step[:2], radius + float(step[2])
    return centre, radius
