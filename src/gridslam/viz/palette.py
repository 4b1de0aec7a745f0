"""Colours of the picture: a quiet map in neutral tones, so that the trajectory has the colour to itself."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from gridslam.types import FloatArray

__all__ = [
    "CLOSURE", "FAINT", "FREE", "OCCUPIED", "REJECTED", "RULE", "TIME_ENDS", "TRUTH", "UNKNOWN", "Colour",
    "time_colours",
]  # fmt: skip

Colour: TypeAlias = tuple[int, int, int]

UNKNOWN: Colour = (226, 229, 232)
FREE: Colour = (253, 253, 252)
OCCUPIED: Colour = (34, 41, 54)
FAINT: Colour = (104, 113, 126)
RULE: Colour = (196, 201, 207)
TRUTH: Colour = (0, 150, 136)
CLOSURE: Colour = (30, 136, 210)
REJECTED: Colour = (160, 167, 176)

# From early to late: lightness (CIE L*) rises evenly from 22 to 73 while the hue turns from violet to orange, so the
# order can be read in grey as well, and the lightest colour still stands out from white.
_TIME_STOPS: tuple[Colour, ...] = (
    (62, 24, 138), (121, 28, 152), (174, 38, 132), (214, 69, 97), (238, 112, 62), (247, 160, 40)
)  # fmt: skip
TIME_ENDS = _TIME_STOPS[0], _TIME_STOPS[-1]


def time_colours(shares: FloatArray) -> list[Colour]:
    """Colours of times (K,) in [0, 1], from early to late."""
    at = np.linspace(0.0, 1.0, len(_TIME_STOPS))
    stops = np.array(_TIME_STOPS)
    channels = [np.interp(shares, at, stops[:, k]).astype(int).tolist() for k in range(3)]
    return list(zip(*channels, strict=True))
