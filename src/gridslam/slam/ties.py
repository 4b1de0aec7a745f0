"""Ties: later key scans matched to submaps about older ones, and how it is known that they belong together."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import IntEnum
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.geometry.se2 import between
from gridslam.grid.arena import Int32Array
from gridslam.grid.tiles import TileMaps
from gridslam.matching.gauss_newton import GaussNewton, degenerate_direction
from gridslam.types import BeamEnds, FloatArray, Match

__all__ = ["Source", "Tie", "seen_from", "surveyed", "ties_from_arrays", "ties_to_arrays"]

_FLOOR = np.diag([1e-2, 1e-2, 1e-2])
"""Information (1/m^2, 1/rad^2) of a direction that a match leaves open: 10 m, 10 rad."""


_CLOSE = GaussNewton(max_iterations=0, dense_spacing_m=1e-3)
"""Looks only at what the ends of beams say across the wall they lie on."""


@final
class Source(IntEnum):
    """How it is known which old submap a key scan sees."""

    BELIEVED = 0
    """The filter has the two at one place, which is no proof."""

    KNOWN = 1
    """The way from the one to the other is too short to be wrong."""

    RECOGNIZED = 2
    """It was searched for, and found there and nowhere else."""


@final
class Tie(NamedTuple):
    """The pose (3,) of a key scan `to` seen from another, `from_`, and its information (3, 3), of g2o's error.

    A match that leaves a direction open (a corridor's axis) says nothing along it: there the measurement is the guess,
    and its information next to none.
    """

    from_: int
    to: int
    measurement: FloatArray
    information: FloatArray
    source: Source
    determined: bool

    @classmethod
    def of(
        cls, from_: int, to: int, guess: FloatArray, match: Match, sigma_m: float, least: float, source: Source
    ) -> Tie:
        """Tie from a match in the frame of `from_`.

        Parameters
        ----------
        guess : (3,) float64
            Where the match began.
        match : Match
            Of one guess.
        sigma_m : float, m
            Standard deviation of what one beam says, beams being correlated.
        least : float
            Least eigenvalue of the position's information, per agreeing beam, that counts as determined.
        """
        pose, information = match.poses[0].copy(), match.information[0] / sigma_m**2
        weak = degenerate_direction(match.information[0], float(match.score[0]), least)
        if weak is not None:
            pose[:2] -= weak * float(weak @ (pose - guess)[:2])
            across = np.eye(3)
            across[:2, :2] -= np.outer(weak, weak)
            information = across @ information @ across
        c, s = math.cos(pose[2]), math.sin(pose[2])
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return cls(from_, to, pose, rotation.T @ information @ rotation + _FLOOR, source, weak is None)


def surveyed(match: Match, maps: TileMaps, row: Int32Array, beams: BeamEnds) -> Match:
    """Take a match for no more informed than what straight walls say across themselves, and corners in all directions.

    Ends that lie sparsely on a wall are mapped as dots, and dots hold the next scan where it happens to be: along a
    bare corridor that is no measurement, although matching is the better for it elsewhere.
    """
    loose = np.full((1, 3, 3), 1e-9) * np.eye(3)
    return replace(match, information=_CLOSE(maps, row, match.poses, loose, beams).information)


def seen_from(frame: FloatArray, match: Match) -> Match:
    """The same match, poses and information, in a frame that is at pose (3,) in the map's."""
    c, s = math.cos(frame[2]), math.sin(frame[2])
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return replace(match, poses=between(frame, match.poses), information=rotation.T @ match.information @ rotation)


def ties_to_arrays(ties: Sequence[Tie]) -> dict[str, NDArray[Any]]:
    """Plain arrays: `ends` (K, 4) int64 (from, to, source, determined), `measurements` and `information`."""
    return {
        "ends": np.array([(t.from_, t.to, t.source, t.determined) for t in ties], np.int64).reshape(-1, 4),
        "measurements": np.array([t.measurement for t in ties], np.float64).reshape(-1, 3),
        "information": np.array([t.information for t in ties], np.float64).reshape(-1, 3, 3),
    }


def ties_from_arrays(arrays: Mapping[str, NDArray[Any]]) -> list[Tie]:
    """Rebuild from `ties_to_arrays`; raises KeyError where an array is missing."""
    rows = zip(arrays["ends"].tolist(), arrays["measurements"], arrays["information"], strict=True)
    return [Tie(a, b, z, omega, Source(source), bool(known)) for (a, b, source, known), z, omega in rows]
