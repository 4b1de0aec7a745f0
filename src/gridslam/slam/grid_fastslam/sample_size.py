"""How many particles the belief needs: few where they agree on where the robot is, many before a loop closes."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.se2 import wrap_poses
from gridslam.particles.kld_sampling import kld_bound
from gridslam.types import FloatArray

_BIN = np.array([0.5, 0.5, math.radians(10)])  # m, m, rad, as AMCL has them: so far apart are two hypotheses
_ERROR = 0.2
"""Greatest Kullback-Leibler divergence, with a probability of 99 %; 2, 3, 4 bins ask for 17, 24, 29 particles."""
_Z = 2.33


def count_needed(poses: FloatArray, about: FloatArray) -> int:
    """Return how many particles a belief needs whose `poses` (N, 3) are spread about one pose (3,); 0 for a single bin.

    Source: Probabilistic Robotics, Table 8.4; D. Fox, Adapting the sample size in particle filters through
    KLD-sampling, IJRR 22 (2003).
    """
    away = wrap_poses(poses - about)
    occupied = len(set(map(tuple, np.round(away / _BIN).tolist())))
    return int(kld_bound(np.array(occupied), _ERROR, _Z))
