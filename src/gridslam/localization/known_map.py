"""The map in which a robot is localized: free space to be in, and obstacles to measure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gridslam.arguments import Limits
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import transform_points
from gridslam.grid.cells import Evidence
from gridslam.grid.tiles import TileMaps
from gridslam.kernels import PAGE, TILE, UNKNOWN, backend
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.models.endpoint import CauchyEndPoint, LikelihoodField
from gridslam.types import Beams, FloatArray, Match, OccupancyGrid, Points, Poses, SensorModel

PoseLikelihood = Callable[[FloatArray], FloatArray]
"""A measurement model conditioned on one scan and one map: log likelihoods (K,) of poses (K, 3)."""

_Point = Annotated[FloatArray, 2]
_OCCUPIED = math.log(0.65 / 0.35)  # as map_server writes and reads maps
_FREE = math.log(0.196 / 0.804)
_PAGE_CELLS = TILE * PAGE
_BAND = 512  # rows at a time
_MOST_SAMPLED = 1_000_000  # free cells, spread evenly, whose spread stands for that of all
_CLOSE_CELLS = 15.5  # as far as tiles know distances
_THROUGH_M = 0.5
"""A beam that ends this far behind the first wall went through it: maps are off by less, and doors are thinner."""

_AGREEING_M = 0.3
"""A beam that ends this close to any obstacle may just have passed a corner."""

_INLIER_WEIGHT = CauchyEndPoint(scale_m=0.1, tempering=1.0)
_NONE = Evidence(1.0, -1.0, -1.0, 1.0, 0.0)  # never asked for: nothing is written into a known map


@final
@checked
class KnownMap:
    """One map for all particles, as `gridslam.types.DistanceMaps` whose rows are all the same.

    A cell is free or occupied where the map is sure of it, with the thresholds of map files: probabilities below 0.196
    and above 0.65. All others, unknown ones first of all, are neither.

    Parameters
    ----------
    grid : OccupancyGrid
        The map; at least one free and one occupied cell.
    reach_m : float, m, > 0
        Where distances saturate; beyond some five standard deviations of a beam it does not matter.
    threads : int
        Threads of the kernels; never changes a result.

    Raises
    ------
    ArgumentError
        No cell is free, or none is occupied: there is nowhere to be, or nothing to see.
    """

    def __init__(self, grid: OccupancyGrid, *, reach_m: float = 1.0, threads: int = 1) -> None:
        self.free: NDArray[np.bool_] = grid.known & (grid.log_odds < _FREE)
        occupied: NDArray[np.bool_] = grid.known & (grid.log_odds > _OCCUPIED)
        for name, some in (("free", self.free), ("occupied", occupied)):
            if not some.any():
                raise ArgumentError("map", f"at least one {name} cell", f"none of {some.shape[1]} x {some.shape[0]}")
        if not reach_m > 0:
            raise ArgumentError("reach_m", "a length above 0 m", reach_m)
        self.grid = grid
        self._mapped = self.free | occupied
        self.reach_m = reach_m
        self.threads = threads
        self.resolution_m = grid.resolution_m
        self._free_cells = np.flatnonzero(self.free).astype(np.int32)  # of the flat map, which has fewer than 2^31
        self._origin = np.array(grid.origin, np.float64)
        rows, columns = self._find_cells(slice(None, None, 1 + len(self._free_cells) // _MOST_SAMPLED))
        places = (np.stack([columns, rows]) + 0.5) * grid.resolution_m + self._origin[:, None]
        self._middle = places.mean(axis=1)
        self._spread = np.cov(places, bias=True)
        reach = math.ceil(reach_m / grid.resolution_m)
        self._rim = reach + 1  # the field is extended beyond the map, to where it is constant
        self._corner = np.array(grid.origin) - self._rim * grid.resolution_m
        cells = _distances_within(np.pad(occupied, self._rim), reach)
        self._distances: NDArray[np.float32] = np.minimum(cells * np.float32(grid.resolution_m), np.float32(reach_m))
        self._tabulated: dict[LikelihoodField | CauchyEndPoint, FieldTable] = {}

    def __repr__(self) -> str:
        """Return one line."""
        height, width = self.free.shape
        return f"KnownMap({width} x {height} cells of {self.resolution_m:g} m, {self.free_area_m2:.0f} m^2 free)"

    @property
    def free_area_m2(self) -> float:
        """Area of all free cells, m^2."""
        return len(self._free_cells) * self.resolution_m**2

    def require(self, pose: Annotated[ArrayLike, 3]) -> None:
        """Raise ArgumentError for a pose (3,) outside the map's borders."""
        place = np.asarray(pose, dtype=np.float64)[:2]
        low = np.array(self.grid.origin)
        high = low + self.resolution_m * np.array(self.free.shape[::-1])
        if (place < low).any() or (place > high).any():
            sides = (f"{c} from {a:g} to {b:g} m" for c, a, b in zip("xy", low, high, strict=True))
            raise ArgumentError("pose", f"a place in the map, {' and '.join(sides)}", f"{place[0]:g}, {place[1]:g}")

    def is_free(self, poses: Poses) -> NDArray[np.bool_]:
        """Return whether each of poses (N, 3) stands on a free cell."""
        return self._is_marked(self.free, poses)

    def _is_marked(self, mask: NDArray[np.bool_], places: FloatArray) -> NDArray[np.bool_]:
        """Return which of places (N, >= 2) lie in cells that are marked in a mask (H, W) of the map; a NaN does not."""
        x, y = ((places[:, axis] - self._origin[axis]) * (1 / self.resolution_m) for axis in (0, 1))
        height, width = mask.shape
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        marked = np.zeros(len(places), np.bool_)
        marked[inside] = mask[y[inside].astype(np.int64), x[inside].astype(np.int64)]
        return marked

    def spread_about(self, pose: Annotated[FloatArray, 3]) -> FloatArray:
        """Mean square (3, 3) of how far poses that are even over free cells and headings are from a pose (3,)."""
        away = self._middle - pose[:2]
        spread = np.zeros((3, 3))
        spread[:2, :2] = self._spread + np.outer(away, away)
        spread[2, 2] = math.pi**2 / 3
        return spread

    def sample_poses(self, count: Annotated[int, Limits(0, 1 << 30)], rng: np.random.Generator) -> FloatArray:
        """Return poses (count, 3), uniform over free cells and headings."""
        rows, columns = self._find_cells(rng.integers(len(self._free_cells), size=count))
        poses = rng.random((count, 3))
        poses[:, :2] = (poses[:, :2] + np.column_stack([columns, rows])) * self.resolution_m + self.grid.origin
        poses[:, 2] = (poses[:, 2] - 0.5) * math.tau
        return poses

    def _find_cells(self, which: NDArray[np.int64] | slice) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Rows and columns of some of the free cells."""
        return np.divmod(self._free_cells[which], np.int32(self.free.shape[1]))

    def blurred_sigma_m(self, sigma_m: float) -> float:
        """Standard deviation of an end's distance to the map's obstacles: a beam's, and the map's rounding to cells."""
        return math.hypot(sigma_m, self.resolution_m / math.sqrt(12))

    def condition(self, sensor: SensorModel, beams: Beams) -> PoseLikelihood:
        """Condition a measurement model on this map and one scan.

        The likelihood of an end point under a likelihood field depends on its distance alone, so it is tabulated for
        all cells once and each scan only adds it up; any other model looks at the map for itself.
        """
        if isinstance(sensor, LikelihoodField | CauchyEndPoint):
            table = self._tabulate(sensor)
            ends = np.ascontiguousarray(beams.ends)
            return lambda poses: table.sums(poses, ends, self.threads)
        log_likelihood = sensor(beams)
        return lambda poses: log_likelihood(self, np.zeros(len(poses), np.int32), poses)

    def inlier_ratio(self, ends: Points, weight: CauchyEndPoint | None = None) -> PoseLikelihood:
        """Inlier ratio (K,) of ends (B, 2) of the base frame at poses (K, 3), by the weight of an end's distance."""
        table = self._tabulate(weight or _INLIER_WEIGHT)
        ends = np.ascontiguousarray(ends)
        return lambda poses: table.sums(poses, ends, self.threads) / len(ends)

    def distances(self, rows: ArrayLike, poses: Poses, points: Points) -> NDArray[np.float32]:
        """Distance in m (K, B) from points (B, 2) of the base frame at poses (K, 3) to the nearest obstacle's centre.

        Capped at `reach_m`, which also holds beyond the map; `rows` (K,) are all one map.
        """
        places = np.zeros((len(poses), len(points), 3))
        places[..., :2] = transform_points(poses[:, None], points)
        found = self._distance_table.sums(places.reshape(-1, 3), np.zeros((1, 2)), self.threads)
        return found.reshape(places.shape[:2]).astype(np.float32)

    def cast_rays(
        self,
        rows: ArrayLike,
        poses: Poses,
        origin: _Point,
        directions: Points,
        max_m: float,
    ) -> NDArray[np.float32]:
        """Range in m (K, B) to the first occupied cell, from origin (2,) along directions (B, 2) of the base frame.

        `max_m` where there is none; directions have length 1; `rows` (K,) are all one map.
        """
        shifted = poses - [*self._corner, 0.0]
        return self._tiles.cast_rays(np.zeros(len(poses), np.int32), shifted, origin, directions, max_m)

    def went_through(self, pose: FloatArray, ends: Points, origin: _Point) -> NDArray[np.bool_]:
        """Return which beams (B,) went through a wall, from origin (2,) to ends (B, 2) in the base frame at a pose."""
        beams = ends - origin
        lengths = np.maximum(np.hypot(*beams.T), 1e-9)
        row = np.zeros(1, np.int32)
        walls_m = self.cast_rays(row, pose[None], origin, beams / lengths[:, None], float(lengths.max()))[0]
        away = self.distances(row, pose[None], ends)[0] > _AGREEING_M
        return np.asarray((walls_m < lengths - _THROUGH_M) & away)

    def ends_beyond(self, pose: FloatArray, ends: Points, origin: _Point) -> NDArray[np.bool_]:
        """Return which beams (B,) end where nothing is mapped and went through no wall; arguments as `went_through`."""
        mapped = self._is_marked(self._mapped, transform_points(pose, ends))
        beyond = ~mapped & (self.distances([0], pose[None], ends)[0] > _INLIER_WEIGHT.scale_m)
        if beyond.any():
            beyond[beyond] = ~self.went_through(pose, ends[beyond], origin)
        return np.asarray(beyond)

    def match(self, matcher: GaussNewton, guesses: Poses, priors: FloatArray, beams: Beams) -> Match:
        """Match a scan near guesses (K, 3) as `GaussNewton` does, with one prior information (3, 3) or with K."""
        shift = np.array([*self._corner, 0.0])
        rows = np.zeros(len(guesses), np.int32)
        each = np.ascontiguousarray(np.broadcast_to(priors, (len(guesses), 3, 3)))
        found = matcher(self._tiles, rows, guesses - shift, each, beams)
        return Match(found.poses + shift, found.information, found.score)

    @cached_property
    def _distance_table(self) -> FieldTable:
        return FieldTable.of(self._distances, self._corner, self.resolution_m)

    @cached_property
    def _tiles(self) -> TileMaps:
        """The map as one of many would be, from its corner on: for kernels that look at it for themselves."""
        reach_cells = min(max(self.reach_m / self.resolution_m, 1.0), _CLOSE_CELLS)
        field = 255 * np.maximum(0, 1 - self._distances / np.float32(reach_cells * self.resolution_m))
        known = np.pad(self.grid.known, self._rim)
        return TileMaps.from_arrays(
            _tiles_of(np.where(known, 0, UNKNOWN).astype(np.int16), np.rint(field).astype(np.uint8)),
            resolution_m=self.resolution_m,
            reach_cells=reach_cells,
            evidence=_NONE,
            threads=self.threads,
        )

    def _tabulate(self, sensor: LikelihoodField | CauchyEndPoint) -> FieldTable:
        """Log likelihood of an end point in each cell."""
        if sensor not in self._tabulated:
            blurred = sensor
            if isinstance(sensor, LikelihoodField):
                blurred = replace(sensor, sigma_hit_m=self.blurred_sigma_m(sensor.sigma_hit_m))
            field = sensor.tempering * blurred.log_likelihoods(self._distances)
            self._tabulated[sensor] = FieldTable.of(field, self._corner, self.resolution_m)
        return self._tabulated[sensor]


def _distances_within(occupied: NDArray[np.bool_], reach: int) -> NDArray[np.float32]:
    """Distances in cells (H, W) to the nearest occupied cell, `reach` at most; some rows at a time, for the memory."""
    from scipy.ndimage import distance_transform_edt  # only who localizes pays for its import

    found = np.full(occupied.shape, reach, np.float32)
    for first in range(0, len(occupied), _BAND):
        low = max(first - reach, 0)
        band = occupied[low : first + _BAND + reach]
        if band.any():
            own = found[first : first + _BAND]
            np.minimum(
                own, np.asarray(distance_transform_edt(~band))[first - low :][: len(own)], out=own, casting="same_kind"
            )
    return found


def _tiles_of(log_odds: NDArray[np.int16], field: NDArray[np.uint8]) -> dict[str, NDArray[Any]]:
    """Lay out cells (H, W) as `TileMaps.to_arrays` does: pages of tiles, all of them there, the first ones empty."""
    pages_up, pages_across = (-(-side // _PAGE_CELLS) for side in field.shape)
    count = pages_up * pages_across
    pages = np.arange((count + 1) * PAGE * PAGE, dtype=np.int32) - (PAGE * PAGE - 1)
    arrays: dict[str, NDArray[Any]] = {
        "roots": np.arange(1, count + 1, dtype=np.int32).reshape(1, pages_up, pages_across),
        "first": np.zeros(2, np.int64),
        "pages": np.maximum(pages, 0).reshape(-1, PAGE, PAGE),
    }
    for name, cells, empty in (("log_odds", log_odds, UNKNOWN), ("field", field, 0)):
        whole = np.full((pages_up * _PAGE_CELLS, pages_across * _PAGE_CELLS), empty, cells.dtype)
        whole[: cells.shape[0], : cells.shape[1]] = cells
        tiles = whole.reshape(pages_up, PAGE, TILE, pages_across, PAGE, TILE).transpose(0, 3, 1, 4, 2, 5)
        arrays[name] = np.concatenate([np.full((1, TILE, TILE), empty, cells.dtype), tiles.reshape(-1, TILE, TILE)])
    return arrays


_STEPS = 255


@final
@dataclass(frozen=True, slots=True, eq=False)
class FieldTable:
    """A field in 255 equal steps; each cell holds four neighbouring values in one word, so a look-up is one load.

    Attributes
    ----------
    patches : (H - 1, W - 1) uint32
        The values of a cell, of that to its right, above, and above to the right.
    corner : (2,) float64, m
        Lower left corner of the first cell.
    resolution_m : float
    least, step : float
        The value that 0 stands for, and what one step is.
    """

    patches: NDArray[np.uint32]
    corner: FloatArray
    resolution_m: float
    least: float
    step: float

    @classmethod
    def of(cls, field: NDArray[np.float32], corner: FloatArray, resolution_m: float) -> FieldTable:
        """Lay out a field (H, W), known at the centres of cells; at least two of these along each side."""
        least = float(field.min())
        step = (float(field.max()) - least) / _STEPS
        steps = np.rint((field - least) / (step or 1.0)).astype(np.uint32)
        patches = steps[:-1, :-1] | steps[:-1, 1:] << 8 | steps[1:, :-1] << 16 | steps[1:, 1:] << 24
        return cls(np.ascontiguousarray(patches, np.uint32), corner, resolution_m, least, step)

    def sums(self, poses: FloatArray, ends: FloatArray, threads: int) -> FloatArray:
        """Sum (K,) of the field over ends (B, 2) of the base frame at poses (K, 3); its border holds beyond it."""
        steps = backend.sum_at_ends(self.patches, self.corner, self.resolution_m, poses, ends, threads)
        return np.asarray(len(ends) * self.least + self.step * steps)
