"""Gauss-Newton of a scan on the distance field of a map, from many guesses at once."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Annotated, ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from gridslam.checked import checked
from gridslam.geometry.single_pose import Information, Pose
from gridslam.grid.tiles import TileMaps
from gridslam.parameters import bounded, parameters
from gridslam.types import BeamEnds, FloatArray, Int32Array, Match, Poses, Rows

MIN_INFORMATION = 0.005
"""Minimum eigenvalue of the position information per inlier beam of a non-degenerate match."""


@final
class PoseMatch(NamedTuple):
    """Result of matching a scan from one guess: a `Match` of one, in numbers."""

    pose: Pose  # where the scan fits best
    information: Information  # of the beams' distances to the map, without the prior
    score: float  # how many of the beams that were matched agree with the map
    agreeing: float  # how many of all beams do

    def degenerate_direction(self, least: float) -> tuple[float, float] | None:
        """Unit vector along which the scan did not determine the position; see `GaussNewton.min_information`."""
        return _degenerate_direction(self.information, self.score, least)


@final
@checked
@parameters(frozen=True)
class GaussNewton:
    """Minimize sum_b w_b d_b^2 + (x - g)^T P (x - g) over poses x, by iteratively reweighted Gauss-Newton.

    d_b is the distance from the end of beam b to the nearest obstacle, interpolated between the field's cells, and
    w_b = 1 / (1 + (d_b / c)^2) its Cauchy weight; g is the guess and P its prior information.

    Parameters
    ----------
    max_iterations : int
        Linearizations at most; a good guess needs three, and 0 only evaluates the guess.
    cauchy_m : float, m
        Distance c at which a beam counts half: two cells of 5 cm, about the thickness of a mapped wall.
    min_information : float
        Least eigenvalue of the position's information, per agreeing beam, that counts as determined; along a
        direction with less (the axis of a bare corridor) the guess is kept.
    point_to_line : bool
        Ends of beams on a straight wall count only across it: along it there is nothing to see, and what the map shows
        there are its cells, which move with the robot: every scan of a corridor hits them in the same places, and they
        would hold the robot where it is. Ends on a straight wall, in unknown cells, whose nearest obstacle lies along
        the wall do not count at all: it goes on where it is not mapped yet, and they would be pulled back to where its
        mapped part ends. Else all count as in the field.

    Attributes
    ----------
    max_step_m, max_step_rad : float
        A step is clipped to these, so that a bad linearization cannot throw the pose away.
    stop_m, stop_rad : float
        Steps below both end the iteration.
    min_beams : int
        With fewer the guess is kept: a few beams fit almost anywhere. Of a full circle in a simulated office ten are
        better than poor odometry, and eight are worse.

    References
    ----------
    Kohlbrecher et al. 2011 (matching on an interpolated grid), with the residual a distance; Censi 2008 (point to
    line).
    """

    max_iterations: int = bounded(10, ge=0, le=1000)
    cauchy_m: float = bounded(0.1, ge=1e-6, le=1e6)
    max_step_m: ClassVar = 0.1
    max_step_rad: ClassVar = 0.1
    stop_m: ClassVar = 0.001
    stop_rad: ClassVar = 2e-4
    min_beams: ClassVar = 10
    min_information: float = bounded(MIN_INFORMATION, ge=0, le=1e6)
    point_to_line: bool = True

    def __call__(
        self, maps: TileMaps, rows: Rows, guesses: Poses, priors: Annotated[FloatArray, "K", 3, 3], beams: BeamEnds
    ) -> Match:
        """Match the scan to maps `rows` (K,) from `guesses` (K, 3) with prior information (K, 3, 3)."""
        return Match(*maps.match(rows, guesses, priors, beams.ends, *self._settings(maps)))

    def match_pose(
        self, maps: TileMaps, row: int, guess: Pose, prior: Information, beams: BeamEnds, thin_m: float = 0.0
    ) -> PoseMatch:
        """Match the scan to map `row` from one guess: as by a call with K = 1, but without an array for each number.

        Where `thin_m` is above 0, of successive ends of beams in a square of this side the first alone is matched: they
        see the same part of an obstacle. What is wrong there is wrong for all of them: a person who walks along, or the
        end of a wall's mapped part beside a robot that drives backwards. Most beams end near the robot, and would
        outweigh the few that determine its place along a corridor.
        """
        return PoseMatch(*maps.match_pose(row, guess, prior, beams.ends, thin_m, *self._settings(maps)))

    def _settings(self, maps: TileMaps) -> tuple[float | bool, ...]:
        """Return the arguments of the kernels, in cells of the maps."""
        cell = maps.resolution_m
        return (
            self.max_iterations,
            self.min_beams,
            self.cauchy_m / cell,
            self.max_step_m / cell,
            self.max_step_rad,
            self.stop_m / cell,
            self.stop_rad,
            maps.reach_cells,
            self.min_information,
            self.point_to_line,
        )


EVALUATE_ONLY = GaussNewton(max_iterations=0)
"""Evaluates the score at the guess without iterating."""


@cache
def evaluating(matcher: GaussNewton) -> GaussNewton:
    """The same that evaluates the score at the guess without iterating."""
    return replace(matcher, max_iterations=0)


_NOTHING_KNOWN = 1e-9
NO_PRIOR = _NOTHING_KNOWN * np.eye(3)
"""Prior information (3, 3) without a guess: directions that no beam determines stay as they are."""

NO_INFORMATION: Information = (_NOTHING_KNOWN, 0.0, 0.0, _NOTHING_KNOWN, 0.0, _NOTHING_KNOWN)
"""The same of one pose, for `match_pose`."""


def degenerate_direction(information: FloatArray, score: float, least: float = MIN_INFORMATION) -> FloatArray | None:
    """Degenerate direction (2,) of a match with this information (3, 3) and score; None if there is none."""
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = information.tolist()
    direction = _degenerate_direction((xx, xy, xt, yy, yt, tt), score, least)
    return None if direction is None else np.array(direction)


def _degenerate_direction(information: Information, score: float, least: float) -> tuple[float, float] | None:
    xx, xy, xt, yy, yt, tt = information
    turn = 1 / max(tt, 1e-12)
    a = xx - xt * xt * turn
    b = xy - xt * yt * turn
    c = yy - yt * yt * turn
    if 0.5 * (a + c) - math.hypot(0.5 * (a - c), b) >= least * score:
        return None
    angle = 0.5 * math.atan2(2 * b, a - c)  # of the strongest direction
    return -math.sin(angle), math.cos(angle)


def cauchy_weights(distances: NDArray[np.float32], scale_m: float) -> NDArray[np.float32]:
    """Cauchy weights (...), in [0, 1], of distances (...) in m to the nearest obstacle; half at `scale_m`."""
    return np.asarray(1 / (1 + np.square(distances / scale_m)), np.float32)


def weigh_known_beams(
    maps: TileMaps, row: Int32Array, pose: FloatArray, ends: FloatArray, scale_m: float
) -> NDArray[np.float32]:
    """Cauchy weights (K,) of those of the ends of beams (B, 2), seen from a pose (3,), that lie in known cells."""
    known = maps.is_known(int(row[0]), ends, pose)
    return cauchy_weights(maps.distances(row, pose[None], ends)[0, known], scale_m)


_MIN_OVERLAP = 0.4
"""Minimum ratio of beams that must end in known cells to be judged alone: of scans far apart much is new."""


def known_inlier_ratio(maps: TileMaps, row: Int32Array, pose: FloatArray, ends: FloatArray, scale_m: float) -> float:
    """Inlier ratio of those of the ends of beams (B, 2), seen from a pose (3,), that lie in known cells.

    Where too few do, the missing ones count as outliers.
    """
    weights = weigh_known_beams(maps, row, pose, ends, scale_m)
    return float(weights.sum()) / max(len(weights), _MIN_OVERLAP * len(ends))


def judged_inlier_ratio(maps: TileMaps, row: Int32Array, pose: FloatArray, beams: BeamEnds, scale_m: float) -> float:
    """Inlier ratio of the beams, seen from a pose (3,), that the map confirms or contradicts.

    They end in known cells, or pass through a mapped obstacle, and are outliers then; beams that end in unknown cells
    before any obstacle do not count. `scale_m` is the distance (m) at which a beam counts half. Where too few count,
    the missing ones are outliers.
    """
    ways = beams.ends - beams.origin
    lengths = np.hypot(*ways.T)
    origin = np.asarray(beams.origin, np.float64)
    free = maps.cast_rays(row, pose[None], origin, ways / lengths[:, None], float(lengths.max()))[0]
    is_known = maps.is_known(int(row[0]), beams.ends, pose)
    passes = ~is_known & (free < lengths - 2 * scale_m)
    weights = cauchy_weights(maps.distances(row, pose[None], beams.ends)[0, is_known], scale_m)
    return float(weights.sum()) / max(len(weights) + int(passes.sum()), _MIN_OVERLAP * len(lengths))
