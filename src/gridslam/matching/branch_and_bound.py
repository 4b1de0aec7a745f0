"""Branch-and-bound scan matching: the best pose in a large window, and the runner-up."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, final

import numpy as np
from numpy.typing import NDArray

from gridslam.arguments import Limits
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.grid.cells import cell_centres, cells_of
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import MOST_BEAM_CELLS, backend
from gridslam.parameters import bounded, parameters
from gridslam.types import FloatArray, IntArray, Points

_MOST_POINTS = 256
"""So many sums of a byte fit in two."""


@final
@checked
@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """A map's likelihoods and their maxima over squares of cells, made once for all searches in it.

    Attributes
    ----------
    cells, nodes, top : uint8 arrays
        See `gridslam.kernels.reference.max_pyramid`.
    corner : (int, int)
        The cell (row, column) of the world that is the map's first.
    resolution_m : float
        Side of a cell.
    """

    cells: NDArray[np.uint8]
    nodes: NDArray[np.uint8]
    top: NDArray[np.uint8]
    corner: tuple[int, int]
    resolution_m: float

    @classmethod
    def of(
        cls,
        maps: TileMaps,
        row: int,
        cauchy_m: Annotated[float, Limits(1e-9, 1e9)] = 0.1,
        most_cells: Annotated[int, Limits(32, 2**16)] = 2**13,
    ) -> Pyramid:
        """Take one map's distances d to 1 / (1 + (d / `cauchy_m`)^2), the weight of `GaussNewton`; 0 out of reach.

        Of a map of more cells than a square of `most_cells` a side only such a square (see `TileMaps.field`).
        """
        field, ids, corner = maps.field_tiles(row, most_cells)
        distance_m = maps.reach_m * (1 - np.arange(256) / 255)
        likelihood = np.rint(255 / (1 + np.square(distance_m / cauchy_m))).astype(np.uint8)
        likelihood[0] = 0
        cells, nodes, top = backend.max_pyramid(field, ids, likelihood)
        return cls(cells, nodes, top, corner, maps.resolution_m)


@final
@dataclass(frozen=True, slots=True, eq=False)
class LatticeMatch:
    """Best pose at lattice resolution; refine by Gauss-Newton.

    Attributes
    ----------
    pose : (3,) float64
        The best pose.
    score : float
        Mean weight of the points there, in [0, 1]: `Match.score` for each beam, up to the lattice.
    runner_up_pose : (3,) float64 or None
        Runner-up pose at another place; None if its score is too low.
    runner_up_score : float
        Its share; 0 where there is none.
    """

    pose: FloatArray
    score: float
    runner_up_pose: FloatArray | None = None
    runner_up_score: float = 0.0


@final
@checked
@parameters(frozen=True)
class BranchAndBound:
    """Finds the best pose of a lattice by branch and bound, and the best pose elsewhere.

    The lattice has the map's cells, and headings between which the ends move by one cell in the root mean square.

    Parameters
    ----------
    window_m, window_rad : float
        Half the sides of the largest window; pi is the full turn.
    gate_sigmas : float
        Mahalanobis distance up to which poses are tried, where the guess has a covariance.
    max_points : int
        Points used in the search, spread evenly in space.
    min_score : float
        Minimum score. A higher value ends unsuccessful searches sooner.
    min_runner_up_ratio : float
        Runner-up poses below this fraction of the best score are not reported.
    runner_up_distance_m, runner_up_distance_rad : float
        A pose within both of the best is the same place. A peak is a few times as wide as `cauchy_m` and as a step of
        the headings; but along a bare corridor it has no end, and the other place is its next part.

    References
    ----------
    Hess et al., Real-time loop closure in 2D lidar SLAM (ICRA 2016), section V; Olson, Real-time correlative
    scan matching (ICRA 2009).
    """

    window_m: float = bounded(15.0, gt=0, le=100)
    window_rad: float = bounded(0.5, gt=0, le=math.pi)
    gate_sigmas: float = bounded(3.0, ge=0.01, le=1000)
    max_points: int = bounded(200, ge=8, le=_MOST_POINTS)
    min_score: float = bounded(0.5, ge=1e-6, le=1)
    min_runner_up_ratio: float = bounded(0.6, ge=1e-6, le=1)
    runner_up_distance_m: float = bounded(1.0, ge=1e-6, le=1e6)
    runner_up_distance_rad: float = bounded(0.3, ge=1e-6, le=100)

    def search(
        self,
        pyramid: Pyramid,
        guess: Annotated[FloatArray, 3],
        covariance: Annotated[FloatArray, 3, 3] | None,
        points: Points,
    ) -> LatticeMatch | None:
        """Search around a guess.

        Parameters
        ----------
        pyramid : Pyramid
            Of the map.
        guess : (3,) float64
            In the map's frame.
        covariance : (3, 3) float64 or None
            Of the guess; poses within `gate_sigmas` of it and in the window are tried. None: the whole window.
        points : (N, 2) float64, m
            Ends of a scan, or of several, in the base frame.

        Returns
        -------
        Found or None
            None where no pose has a share of `min_score`.

        Raises
        ------
        ArgumentError
            The guess or a point is not finite, or the covariance is not positive semidefinite.
        """
        if not np.isfinite(guess).all():
            raise ArgumentError("guess", "finite x, y, theta", guess.tolist())
        if not np.isfinite(points).all():
            raise ArgumentError("points", "finite x, y", "a point that is not finite")
        most_m = MOST_BEAM_CELLS * pyramid.resolution_m
        if np.abs(points).max(initial=0.0) > most_m:
            raise ArgumentError("points", f"ends of beams within {most_m:g} m", "one farther away")
        if not len(points):
            return None
        cell = pyramid.resolution_m
        corner = np.array(pyramid.corner)
        few = thin_points(points, self.max_points, cell)
        step_rad = cell / max(math.sqrt(float(np.square(few).sum(axis=1).mean())), cell)
        sides, information = self._ellipsoid(covariance, np.array([cell, cell, step_rad]))
        turns = math.floor(sides[2] / step_rad)
        headings = guess[2] + step_rad * np.arange(-turns, turns + 1)
        y, x = (cells_of(guess[:2], cell) - corner).tolist()
        across, up = np.ceil(sides[:2] / cell).astype(int).tolist()
        unit = np.array([cell, cell, 1.0])
        places = backend.correlate(
            pyramid.cells,
            pyramid.nodes,
            pyramid.top,
            few / cell,
            headings,
            (x - across, x + across + 1, y - up, y + up + 1),
            guess / unit - np.append(corner[::-1], 0),
            information * unit[:, None] * unit,
            1.0,
            2,
            math.ceil(self.min_score * 255 * len(few)),
            self.min_runner_up_ratio,
            self.runner_up_distance_m / cell,
            self.runner_up_distance_rad,
        )
        poses = np.column_stack([cell_centres(places[:, 2:] + corner, cell), wrap(headings[places[:, 1]])])
        matches = zip(poses, (places[:, 0] / (255 * len(few))).tolist(), strict=True)
        return LatticeMatch(*chain.from_iterable(matches)) if len(places) else None

    def _ellipsoid(self, covariance: FloatArray | None, steps: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Half the sides (3,) of the window, and the information (3, 3) of the ellipsoid d^T information d <= 1 in it.

        The ellipsoid is widened until it holds the pose next to the guess of a lattice of spacing `steps` (3,).
        """
        largest = np.array([self.window_m, self.window_m, self.window_rad])
        if covariance is None:
            return largest, np.zeros((3, 3))
        fits = covariance.shape == (3, 3) and np.isfinite(covariance).all()
        if not fits or np.linalg.eigvalsh(covariance)[0] < -1e-9 * np.abs(covariance).max():
            raise ArgumentError("covariance", "a positive semidefinite matrix (3, 3)", covariance.tolist())
        spread = self.gate_sigmas**2 * covariance + np.diag(0.75 * np.square(steps))
        information: FloatArray = np.asarray(np.linalg.inv(spread), dtype=np.float64)
        return np.minimum(largest, np.sqrt(np.diag(spread))), information


@checked
def thin_points(
    points: Points, most: Annotated[int, Limits(4, 1 << 31)], finest_m: Annotated[float, Limits(1e-9, 1e9)] = 0.05
) -> FloatArray:
    """At most `most` of points (N, 2), spread evenly in space: the first in each square of the finest grid that does.

    Grids have sides `finest_m`, and each next one a tenth more; `most` is 4 or more.
    """

    def cells(grid: int) -> IntArray:
        whole = np.floor(points * (1 / (finest_m * 1.1**grid))).astype(np.int64)
        return np.asarray((whole[:, 0] << 32) + whole[:, 1])

    def count(grid: int) -> int:
        return 1 + int(np.count_nonzero(np.diff(np.sort(cells(grid)))))

    grid = 0 if len(points) <= most else bisect_left(range(200), -most, key=lambda grid: -count(grid))
    firsts = np.unique(cells(grid), return_index=True)[1]
    return np.asarray(points[np.sort(firsts)])
