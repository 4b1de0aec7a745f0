"""Recovery from localization failure: augmented Monte Carlo localization."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple, final

import numpy as np

from gridslam.arguments import SHARE
from gridslam.geometry.angles import wrap_headings
from gridslam.localization.belief import JITTER
from gridslam.localization.known_map import KnownMap, PoseLikelihood
from gridslam.models.endpoint import CauchyEndPoint
from gridslam.parameters import bounded, parameters
from gridslam.types import Beams, FloatArray


class InlierRatioAverages(NamedTuple):
    """Inlier ratio with the map, averaged over the particles and, slowly and fast, over updates."""

    slow: Annotated[float, SHARE]
    fast: Annotated[float, SHARE]


@final
@parameters(frozen=True)
class AugmentedRecovery:
    """Probability that the robot is somewhere else: 1 - w_fast / w_slow, where that is positive.

    Parameters
    ----------
    alpha_slow, alpha_fast : float, [0, 1]
        What a new scan counts in the slow and in the fast average; both 0: no recovery. 0.001 and 0.1 are what AMCL's
        documentation suggests.
    expected : float, [0, 1]
        Initial value of both averages: the inlier ratio with a correct map that is some years old.
        This also recovers from a wrong initial pose.

    Notes
    -----
    The book averages the likelihood of whole scans. That of 60 beams varies by many orders of magnitude from one scan
    to the next, and its average is dominated by the greatest one. The inlier ratio lies in [0, 1] and can be compared
    between scans, robots and sensor models.

    References
    ----------
    Probabilistic Robotics, Table 8.3 (`Augmented_MCL`).
    """

    alpha_slow: float = bounded(0.001, ge=0, le=1)
    alpha_fast: float = bounded(0.1, ge=0, le=1)
    expected: float = bounded(0.6, ge=0, le=1)

    def begin(self) -> InlierRatioAverages:
        """Averages before the first scan."""
        return InlierRatioAverages(self.expected, self.expected)

    def __call__(
        self, averages: InlierRatioAverages, inlier_ratio: float, seen: float = 1.0
    ) -> tuple[InlierRatioAverages, float]:
        """Average the share of agreeing beams in; the share of the belief that is elsewhere, in [0, 1).

        A scan counts by the ratio of its beams that have `seen` something of the map. The share is 0 where none has:
        there is no reason to look elsewhere. It is not reduced where some have, as at the edge of what is mapped:
        multiplied by that ratio, 7 of 100 starts in half-mapped buildings are reported at a wrong place, in place of 4.
        """
        slow = averages.slow + seen * self.alpha_slow * (inlier_ratio - averages.slow)
        fast = averages.fast + seen * self.alpha_fast * (inlier_ratio - averages.fast)
        return InlierRatioAverages(slow, fast), max(0.0, 1 - fast / slow) if slow > 0 and seen > 0 else 0.0


SAMPLES_PER_M2 = 500.0
"""How many poses are looked at where nothing is known: they put ten within 0.3 m and 10 degrees of every pose."""

SAMPLES_MAX = 1_000_000
"""At most; they take a second."""

SEARCH_SCALE_M = 0.2
"""Distance at which a beam agrees by half: as wide as the poses looked at are apart, not as beams are exact."""

_DRAWS = 50_000
"""How many of them are chosen."""

_CONCENTRATION = 25.0
"""log q is this multiple of the inlier ratio."""


def propose_poses(
    known_map: KnownMap, beams: Beams, log_likelihood: PoseLikelihood, share: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Draw poses from all over the map, more of them where the scan fits, and weigh them so that they stand for all.

    Poses spread evenly over the free space are as many as are worth a look; those whose beams agree with the map are
    chosen, and moved a little, half of what the poses looked at are apart. Each then carries the importance weight
    p(z | x) p(x) / q(x), p(x) being even over the free space and q(x) what it was chosen with. Of all samples a `share`
    in (0, 1] is drawn; returns poses (K, 3) and log weights (K,), whose sum is the evidence: the mean of p(z | x) over
    the free space.

    References
    ----------
    Probabilistic Robotics, Section 8.3.5 (random particles from the measurement); S. Lenser and M. Veloso,
    Sensor resetting localization for poorly modelled mobile robots, ICRA 2000.
    """
    count = math.ceil(_DRAWS * share)
    samples = math.ceil(min(SAMPLES_PER_M2 * known_map.free_area_m2, SAMPLES_MAX) * share)
    poses = known_map.sample_poses(samples, rng)
    agree = known_map.condition(CauchyEndPoint(scale_m=SEARCH_SCALE_M, tempering=1.0), beams)
    log_q = agree(poses) * (_CONCENTRATION / len(beams))
    ends = np.cumsum(np.exp(log_q - log_q.max()))
    chosen = np.minimum(ends.searchsorted(rng.random(count) * ends[-1], side="right"), len(poses) - 1)
    log_mean_q = math.log(ends[-1] / len(poses)) + log_q.max()
    moved = wrap_headings(poses[chosen] + rng.normal(size=(count, 3)) * JITTER)
    poses = np.where(known_map.is_free(moved)[:, None], moved, poses[chosen])  # none out of the free space
    return poses, log_likelihood(poses) + log_mean_q - log_q[chosen] - math.log(count)
