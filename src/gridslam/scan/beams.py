"""The beams of a scan that are used: where they end, seen from the robot's base."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol, final

import numpy as np

from gridslam.scan.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from gridslam.scan.laser_scan import LaserScan

__all__ = ["BeamEnds", "Beams", "StoredScan"]

_STRAIGHT = 1e-12  # rad/s: a turn below this moves nothing by a rounding error


@final
@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The usable beams of a scan in the base frame; what matchers, sensor models and mappers work on.

    Attributes
    ----------
    scan : LaserScan
        Where they come from.
    indices : (K,) int64
        Which beams of the scan they are.
    ends : (K, 2) float64, m
        End points in the base frame.
    origin : (2,) float64, m
        The laser's place in the base frame.
    turn_rate_rps : float, rad/s
        Turn of the base during the scan that is undone in them; 0 where none is.
    """

    scan: LaserScan
    indices: IntArray
    ends: FloatArray
    origin: FloatArray
    turn_rate_rps: float = 0.0

    def __len__(self) -> int:
        """Return the number of usable beams K."""
        return len(self.ends)

    def __repr__(self) -> str:
        """Return one line."""
        return f"Beams({len(self)} of {len(self.scan)}, up to {self.reach_m:.2f} m)"

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base; what a map must cover around the pose."""
        return _reach_m(self.ends, self.origin)

    def deskew(self, twist: FloatArray) -> Beams:
        """Undo the robot's motion during the scan: all beams as if they had been measured at the scan's stamp.

        A beam that was measured t seconds after the stamp left the laser, and ended, where the base then was: both lie
        at exp(t twist) from the base at the stamp. To be applied once, to beams as `LaserScan.beams` selects them.

        Parameters
        ----------
        twist : (3,) float64
            Motion of the base, [v_x m/s, v_y m/s, omega rad/s] in its own frame, taken as constant during the scan.

        Returns
        -------
        Beams
            With exact ends. All rays begin at one `origin`, the mean of the laser's places: rays of a scan leave from
            within half the path of the laser during the scan, 2 cm at 0.4 m/s and 10 scans a second. The same object
            where the scan has no beam times.

        Source: Sola et al., A micro Lie theory (2018), equations 156 and 158, as complex numbers.
        """
        if self.scan.beam_times_s is None or not len(self.ends):
            return self
        v_x, v_y, omega = twist.tolist()
        times = self.scan.beam_times_s.take(self.indices)
        half_turns = np.empty(len(times), np.complex128)
        half_turns.real, half_turns.imag = np.cos(0.5 * omega * times), np.sin(0.5 * omega * times)
        chords = half_turns.imag * (2 / omega) if abs(omega) > _STRAIGHT else times
        ways, turns = complex(v_x, v_y) * chords * half_turns, half_turns * half_turns
        ends = turns * self.ends.view(np.complex128)[:, 0] + ways
        origin = (turns * complex(*self.origin.tolist()) + ways).mean(keepdims=True)
        return Beams(self.scan, self.indices, ends.view(np.float64).reshape(-1, 2), origin.view(np.float64), omega)


@final
@dataclass(frozen=True, slots=True, eq=False)
class StoredScan:
    """End points (K, 2) of the usable beams and origin (2,) of a stored scan."""

    ends: FloatArray
    origin: FloatArray

    def __len__(self) -> int:
        """Return the number of beams K."""
        return len(self.ends)

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base."""
        return _reach_m(self.ends, self.origin)


class BeamEnds(Protocol):
    """Where beams end, seen from the base: `Beams` of a scan at hand, or `StoredScan` of one that was kept."""

    @property
    def ends(self) -> FloatArray:
        """End points (K, 2) in the base frame, m."""

    @property
    def origin(self) -> FloatArray:
        """The laser's place (2,) in the base frame, m."""

    @property
    def reach_m(self) -> float:
        """Distance of the farthest end or of the laser from the base."""

    def __len__(self) -> int:
        """Return the number of beams K."""


def _reach_m(ends: FloatArray, origin: FloatArray) -> float:
    farthest = np.einsum("ij,ij->i", ends, ends).max(initial=float(origin @ origin))
    return math.sqrt(farthest)
