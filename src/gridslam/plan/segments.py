"""Many line segments as arrays: positions of all of them relative to one of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np

from gridslam.plan.untyped import require_map_extra
from gridslam.types import FloatArray, IntArray


@final
@dataclass(frozen=True, eq=False)
class Segments:
    """Directed line segments.

    Attributes
    ----------
    ends : (S, 2, 2) float64, m
    alongs, normals : (S, 2) float64
        Unit vectors along each, and to its left.
    lengths : (S,) float64, m
    """

    ends: FloatArray
    alongs: FloatArray
    normals: FloatArray
    lengths: FloatArray

    @classmethod
    def of(cls, ends: FloatArray) -> Segments:
        """Take segments (S, 2, 2)."""
        ends = np.asarray(ends, np.float64).reshape(-1, 2, 2)
        apart = ends[:, 1] - ends[:, 0]
        lengths = np.hypot(*apart.T)
        alongs = apart / np.maximum(lengths, 1e-9)[:, None]
        return cls(ends, alongs, np.column_stack([-alongs[:, 1], alongs[:, 0]]), lengths)

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.ends)

    def near(self, points: FloatArray, reach_m: float) -> tuple[IntArray, Segments]:
        """Numbers, in order, of those whose upright boxes meet that about points (N, 2) and a margin; and they."""
        _, shapely = require_map_extra()
        box = shapely.box(*points.min(axis=0) - reach_m, *points.max(axis=0) + reach_m)
        found = np.sort(self._boxes.query(box))
        return found, Segments(self.ends[found], self.alongs[found], self.normals[found], self.lengths[found])

    @cached_property
    def _boxes(self) -> Any:  # noqa: ANN401
        """A tree of the upright boxes about the segments."""
        _, shapely = require_map_extra()
        return shapely.STRtree(shapely.box(*self.ends.min(axis=1).T, *self.ends.max(axis=1).T))

    def locate(self, start: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far all ends (S, 2) are from a point along a direction, and to its left."""
        apart = self.ends - start
        return apart @ along, apart @ np.array([-along[1], along[0]])

    def distances(self, points: FloatArray) -> FloatArray:
        """Distances (N, S) of points (N, 2) from the segments."""
        apart = points[:, None] - self.ends[None, :, 0]
        steps = np.clip((apart * self.alongs).sum(axis=2), 0, self.lengths)
        return np.asarray(np.hypot(*(apart - steps[..., None] * self.alongs).transpose(2, 0, 1)))
