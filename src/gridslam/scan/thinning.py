"""How many beams of a dense scan are used."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as parameters

from gridslam.scan.arrays import FloatArray

__all__ = ["Thinning"]

_TINY = float(np.finfo(np.float64).tiny)


@final
@parameters(frozen=True, config=ConfigDict(extra="forbid"))
class Thinning:
    """Takes of a dense scan only one beam for each bit of arc about the laser.

    Otherwise near structure outweighs all the rest, and thousands of beams cost time without new information.

    Parameters
    ----------
    spacing_m : float, m, >= 0
        Arc for which one beam is taken; half a cell of 5 cm, so that every cell of a wall is still hit. 0 takes all.
    dense_beams : int, >= 1
        A scan of more usable beams is dense, and about as many are kept at least: a turn of whole degrees, or half a
        one of half degrees, has no more, and is used as it is.
    """

    spacing_m: float = Field(default=0.025, ge=0)
    dense_beams: int = Field(default=400, ge=1)

    def __call__(self, ranges: FloatArray, widths: FloatArray) -> NDArray[np.bool_] | None:
        """Which beams to take: the first ones in equal parts of the arc that they sweep; None for all.

        Parameters
        ----------
        ranges : (K,) float64, m
            Of the usable beams, in their order.
        widths : (K,) float64, rad
            Angle between each beam of these and the one before it in the scan.
        """
        if not self.spacing_m or len(ranges) <= self.dense_beams:
            return None
        arc = np.cumsum(widths * ranges)
        part = np.floor(arc / max(min(self.spacing_m, arc[-1] / self.dense_beams), _TINY))
        first = np.empty(len(part), bool)
        first[0] = True
        np.not_equal(part[1:], part[:-1], out=first[1:])
        return first
