"""Bound the memory of all particles' maps together."""

from __future__ import annotations

from typing import final

import numpy as np

from gridslam.parameters import bounded, parameters
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, IntArray

_EVERY = 16
"""Key scans from one count of the tiles to the next."""

_KEPT_RATIO = 0.75
"""Share of the tiles beside the best map's down to which particles give way."""


@final
@parameters(frozen=True)
class MapLimit:
    """Where the particles' maps differ too much, particles of least weight give way to the others.

    Maps share the tiles in which they are alike, and resampling makes them so again. But on open ground the weights
    stay even for a kilometre, nothing is resampled, and in the end every particle would have a map of its own: 30 of
    them took 540 MB on 460 m x 230 m. What decides is the number of tiles, never what memory the machine has left, so
    that a run can be repeated.

    Parameters
    ----------
    tiles_per_particle : int
        Limit of the tiles (2 KB each) of all maps, as a multiple of the greatest number of particles. A third of it is
        always left to the particles beside the best one's map. With 1700 and 30 particles that is 104 MB; 370 to 1430
        are needed where robots drive inside. Take more where a scan alone covers as many: a full turn of 40 m, all of
        it open, in cells of 5 cm.
    """

    tiles_per_particle: int = bounded(1700, ge=1, le=500_000_000)

    def __call__(self, state: GridFastSlamState) -> IntArray | None:
        """Index of the particle that each continues, (N,); None if maps are within the limit, or not counted now."""
        count = len(state.poses)
        maps = state.maps
        limit = self.tiles_per_particle * state.particles_max
        if state.ancestry.steps % _EVERY or maps.tiles_used <= limit:
            return None
        best = maps.tiles_of(np.array([state.best]))
        order = np.argsort(-state.log_weights, kind="stable")
        apart = max(limit - best, limit // 3)
        kept = count
        while kept > 1 and maps.tiles_of(order[:kept]) - best > (apart if kept == count else _KEPT_RATIO * apart):
            kept = kept * 4 // 5
        return None if kept == count else _apportion(state.log_weights, order[:kept])


def _apportion(log_weights: FloatArray, kept: IntArray) -> IntArray:
    """Particles `kept` (K,) in the numbers that their weights are worth, to a whole one, as many as there are weights.

    Each goes on once at least, and beyond that the greatest remainders do.
    """
    weights = np.exp(log_weights[kept])
    spare = (len(log_weights) - len(kept)) * weights / weights.sum()
    times = 1 + spare.astype(np.int64)
    left = len(log_weights) - int(times.sum())
    times[np.argsort(np.floor(spare) - spare, kind="stable")[:left]] += 1
    return np.repeat(kept, times)
