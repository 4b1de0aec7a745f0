"""Constraints between key scans and older submaps, and their origin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from enum import IntEnum
from typing import Annotated, NamedTuple, final

import numpy as np

from gridslam.arguments import index_of
from gridslam.geometry.se2 import adjoint, between, inverse, rotate_covariances
from gridslam.matching.gauss_newton import degenerate_direction
from gridslam.types import FloatArray, IntArray, Match

_MOST_RECOGNIZED = 300  # that are shown; of more every second, third, ...
_KEY_SCANS_APART = 20  # of the tracked ones that are shown, the later key scans
_FLOOR = np.diag([1e-2, 1e-2, 1e-2])
"""Information (1/m^2, 1/rad^2) along a degenerate direction: 10 m, 10 rad."""


@final
class ConstraintSource(IntEnum):
    """Origin of the data association of a constraint."""

    PROXIMITY = 0
    """Associated by the filter's pose estimate; not independent evidence."""

    TRACKED = 1
    """Associated by tracking; the relative pose is certain."""

    RECOGNIZED = 2
    """Found by place recognition, unambiguously."""


@final
class Constraint(NamedTuple):
    """The pose (3,) of a key scan `to` seen from another, `from_`, and its information (3, 3), of g2o's error.

    Along a degenerate direction (a corridor's axis) the measurement equals the guess and its information is near zero.
    """

    from_: Annotated[int, index_of("T")]
    to: Annotated[int, index_of("T")]
    measurement: Annotated[FloatArray, 3]
    information: Annotated[FloatArray, 3, 3]
    source: ConstraintSource
    determined: bool

    @property
    def pair(self) -> tuple[int, int]:
        """Both key scans."""
        return self.from_, self.to

    @property
    def is_certain(self) -> bool:
        """Whether it determines the whole relative pose, by more than the filter's estimate."""
        return self.determined and self.source is not ConstraintSource.PROXIMITY

    @property
    def identity(self) -> tuple[int, int, bytes]:
        """Key scans and measurement, by which a constraint is found again among others."""
        return self.from_, self.to, self.measurement.tobytes()

    def reverse(self) -> Constraint:
        """Return the same measurement as the pose of `from_` seen from `to`."""
        measurement = inverse(self.measurement)
        turned = adjoint(measurement)
        information = turned.T @ self.information @ turned
        return self._replace(from_=self.to, to=self.from_, measurement=measurement, information=information)

    @classmethod
    def from_match(
        cls,
        from_: int,
        to: int,
        guess: FloatArray,
        match: Match,
        sigma_m: float,
        least: float,
        source: ConstraintSource,
    ) -> Constraint:
        """Constraint from a match in the frame of `from_`.

        Parameters
        ----------
        guess : (3,) float64
            Where the match began.
        match : Match
            Of one guess.
        sigma_m : float, m
            Standard deviation of one beam, inflated for correlated beams.
        least : float
            Minimum eigenvalue of the position information per inlier beam of a non-degenerate match.
        """
        (pose,), (information,) = match.poses, match.information
        weak = degenerate_direction(information, float(match.score[0]), least)
        along = np.zeros((3, 1))
        if weak is not None:
            along[:2, 0] = weak
        across = np.eye(3) - along * along.T
        pose = pose - (along * (along.T @ (pose - guess)[:, None]))[:, 0]
        (weight,) = _rotate((across @ (information / sigma_m**2) @ across)[None], pose[None]) + _FLOOR
        return cls(from_, to, pose, weight, source, weak is None)


def transform_match(frame: FloatArray, match: Match) -> Match:
    """The same match, poses and information, in a frame that is at pose (3,) in the map's."""
    return replace(match, poses=between(frame, match.poses), information=_rotate(match.information, frame))


def key_scan_pairs(constraints: Iterable[Constraint]) -> IntArray:
    """Pairs of key scans (K, 2) that constraints connect: from, to."""
    return np.array([key for constraint in constraints for key in constraint.pair], np.int64).reshape(-1, 2)


def select_shown_closures(recognized: IntArray, tracked: IntArray) -> IntArray:
    """Select the loop closures (K, 2) that pictures show of `recognized` (C, 2) and `tracked` (R, 2) ones.

    Rows are pairs of key scans, the older one first. All recognized ones are shown, of more than 300 every second,
    third, ...; of the tracked ones the first whose later key scan lies in each block of 20.
    """
    known = tracked[np.flatnonzero(np.diff(tracked[:, 1] // _KEY_SCANS_APART, prepend=-1))]
    return np.concatenate([known, recognized[:: -(-len(recognized) // _MOST_RECOGNIZED) or 1]])


def _rotate(information: FloatArray, frame: FloatArray) -> FloatArray:
    """Information (..., 3, 3) in the axes of frames at poses (3,) or (..., 3)."""
    return rotate_covariances(information, -frame[..., 2])
