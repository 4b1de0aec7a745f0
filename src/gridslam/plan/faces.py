"""Faces: the straight surfaces of walls and furniture, found among surface points and fitted to them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import final

import numpy as np

from gridslam.plan.rasters import BoolArray
from gridslam.plan.surfaces import SurfacePoints, label_surfaces
from gridslam.types import FloatArray, IntArray

_GAP_M = 0.3
"""Along a face points are no farther apart: less than a door, more than beams are at 15 m."""
_OFFSET_M = 0.05
"""Points of a face lie no farther from its line."""
_LEAST_COSINE = np.cos(np.deg2rad(15))
"""Of the angle between the normals of a face and of its points, at least."""
_MOST_WEIGHT = 20.0
_FEWEST = 4
_MOST_ASKED = 1000
"""Points that are asked where most agree: of more a part does."""
_SHORTEST_M = 0.25
_ROUNDS = 4
_SNAP_M = 0.02
"""Ends may move by so much when a face is turned to a dominant direction."""
_SNAP_RAD = np.deg2rad(3)


@final
@dataclass(frozen=True, slots=True, eq=False)
class Face:
    """A straight surface, seen from one side.

    Attributes
    ----------
    middle : (2,) float64, m
        A point on it.
    direction : float, rad
        Direction along it; free space lies to its left.
    begin, end : float, m
        From `middle` along the direction, begin < end.
    weight : float
        Of the points that it was fitted to.
    """

    middle: FloatArray
    direction: float
    begin: float
    end: float
    weight: float

    @property
    def along(self) -> FloatArray:
        """Unit vector (2,) along the face."""
        return np.array([np.cos(self.direction), np.sin(self.direction)])

    @property
    def normal(self) -> FloatArray:
        """Unit vector (2,) into free space."""
        return np.array([-np.sin(self.direction), np.cos(self.direction)])

    @property
    def length_m(self) -> float:
        """Length of the face."""
        return self.end - self.begin

    @property
    def ends(self) -> FloatArray:
        """Both ends (2, 2), m."""
        return self.middle + np.outer([self.begin, self.end], self.along)

    def locate(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distances (N,) of points (N, 2) from the middle along the face, and to its left."""
        apart = points - self.middle
        return apart @ self.along, apart @ self.normal


def find_surfaces(points: SurfacePoints) -> Iterator[SurfacePoints]:
    """Yield the points of each connected surface."""
    labels = label_surfaces(points)
    order = np.argsort(labels, kind="stable")
    starts = np.flatnonzero(np.diff(labels[order], prepend=-1))
    ordered = replace(points.select(order), weights=points.weights[order].clip(max=_MOST_WEIGHT))
    for begin, end in pairwise([*starts.tolist(), len(points)]):
        yield ordered.select(slice(begin, end))


def find_faces(left: SurfacePoints) -> Iterator[Face]:
    """Take straight faces of 0.25 m and more from a connected surface, each grown from where most points agree."""
    while len(left) >= _FEWEST and np.hypot(*np.ptp(left.positions, axis=0)) >= _SHORTEST_M:
        taken, face = _grow(left, _choose_seed(left))
        if face is not None and face.length_m >= _SHORTEST_M:
            yield face
        left = left.select(~taken)


def _choose_seed(left: SurfacePoints) -> int:
    """Return the point whose line has most points, of at most 40 that are tried."""
    tried = np.linspace(0, len(left) - 1, min(40, len(left))).astype(np.int64)
    places, normals = left.positions[tried], left.normals[tried]
    asked = left.select(slice(None, None, 1 + len(left) // _MOST_ASKED))
    offsets = asked.positions @ normals.T - (places * normals).sum(axis=1)
    agree = (np.abs(offsets) < _OFFSET_M) & (asked.normals @ normals.T > _LEAST_COSINE)
    return int(tried[np.argmax(asked.weights @ agree)])


def _grow(left: SurfacePoints, seed: int) -> tuple[BoolArray, Face | None]:
    """Fit a line to the points that agree with it, again and again; which are taken, and the face."""
    middle, normal = left.positions[seed], left.normals[seed]
    taken = np.zeros(len(left), np.bool_)
    taken[seed] = True
    agree = np.zeros(0, np.int64)
    for _ in range(_ROUNDS):
        apart, before = left.positions - middle, agree
        agree = np.flatnonzero((np.abs(apart @ normal) < _OFFSET_M) & (left.normals @ normal > _LEAST_COSINE))
        if len(agree) < _FEWEST - 1:
            return taken, None
        agree = agree[_run(apart[agree] @ np.array([normal[1], -normal[0]]))]
        if np.array_equal(agree, before):
            break
        middle, normal = _fit(left.positions[agree], left.weights[agree], normal)
        taken[agree] = True
    direction = float(np.arctan2(-normal[0], normal[1]))
    along = (left.positions[agree] - middle) @ np.array([normal[1], -normal[0]])
    return taken, Face(middle, direction, float(along.min()), float(along.max()), float(left.weights[agree].sum()))


def _run(along: FloatArray) -> IntArray:
    """Of places (N,) along a line the numbers of those in the run without a gap that has most of them."""
    order = np.argsort(along)
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(along[order]) > _GAP_M) + 1, [len(along)]])
    most = np.argmax(np.diff(bounds))
    return order[bounds[most] : bounds[most + 1]]


def _fit(positions: FloatArray, weights: FloatArray, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Middle and normal of the line through points, by total least squares."""
    middle = weights @ positions / weights.sum()
    apart = positions - middle
    (xx, xy), (_, yy) = (apart.T * weights) @ apart
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    across = np.array([-np.sin(turn), np.cos(turn)])
    return middle, across if across @ normal > 0 else -across


def dominant_direction(faces: list[Face]) -> float:
    """Dominant direction of the faces by length, modulo pi/2 (rad, [-pi/4, pi/4)); 0 without faces."""
    if not faces:
        return 0.0
    angles = np.array([face.direction for face in faces])
    lengths = np.array([face.length_m for face in faces])
    histogram = np.bincount((np.rad2deg(angles) % 90).astype(np.int64) % 90, lengths**2, 90)
    peak = np.deg2rad(np.argmax(histogram + np.roll(histogram, 1) + np.roll(histogram, -1)) + 0.5)
    off = (angles - peak + np.pi / 4) % (np.pi / 2) - np.pi / 4
    near = np.abs(off) < np.deg2rad(3)
    found = peak + np.average(off[near], weights=lengths[near] ** 3)
    return float((found + np.pi / 4) % (np.pi / 2) - np.pi / 4)


def snap_directions(faces: list[Face], dominant_rad: float) -> list[Face]:
    """Turn faces to the dominant direction, or across it, where their ends move by less than 2 cm."""
    snapped = []
    for face in faces:
        off = (face.direction - dominant_rad + np.pi / 4) % (np.pi / 2) - np.pi / 4
        if abs(off) < _SNAP_RAD and abs(off) * face.length_m / 2 < _SNAP_M:
            shift = (face.begin + face.end) / 2
            middle = face.middle + shift * face.along
            half = face.length_m / 2
            face = replace(face, middle=middle, direction=face.direction - off, begin=-half, end=half)
        snapped.append(face)
    return snapped
