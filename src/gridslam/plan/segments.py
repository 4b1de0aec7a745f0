"""Many line segments as arrays: positions of all of them relative to one of them."""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from gridslam.types import FloatArray


@final
class Segments(NamedTuple):
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

    def locate(self, start: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far all ends (S, 2) are from a point along a direction, and to its left."""
        apart = self.ends - start
        return apart @ along, apart @ np.array([-along[1], along[0]])
