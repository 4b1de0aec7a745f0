"""A field over a map, laid out so that it is summed over the ends of many beams at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from gridslam.kernels import backend
from gridslam.types import FloatArray

__all__ = ["FieldTable"]

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
        least, most = float(field.min()), float(field.max())
        step = (most - least) / _STEPS
        steps = np.rint((field - least) / (step or 1.0)).astype(np.uint32)
        patches = steps[:-1, :-1] | steps[:-1, 1:] << 8 | steps[1:, :-1] << 16 | steps[1:, 1:] << 24
        return cls(np.ascontiguousarray(patches), corner, resolution_m, least, step)

    def sums(self, poses: FloatArray, ends: FloatArray, threads: int) -> FloatArray:
        """Sum (K,) of the field over ends (B, 2) of the base frame at poses (K, 3); its border holds beyond it."""
        steps: FloatArray = backend.sum_at_ends(self.patches, self.corner, self.resolution_m, poses, ends, threads)
        return len(ends) * self.least + self.step * steps
