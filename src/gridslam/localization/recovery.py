"""Recovery from localization failure: augmented Monte Carlo localization."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple, final

import numpy as np

from gridslam.arguments import SHARE
from gridslam.geometry.angles import wrap
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

        A scan counts by the ratio of its beams that have `seen` something of the map, and the share by the same ratio:
        where nothing is mapped, there is no reason to look elsewhere.
        """
        slow = averages.slow + seen * self.alpha_slow * (inlier_ratio - averages.slow)
        fast = averages.fast + seen * self.alpha_fast * (inlier_ratio - averages.fast)
        return InlierRatioAverages(slow, fast), seen * max(0.0, 1 - fast / slow) if slow > 0 else 0.0


@final
@parameters(frozen=True)
class MeasurementProposal:
    """Draws poses from all over the map, more of them where the scan fits, and weighs them so that they stand for all.

    Poses spread evenly over the free space are as many as are worth a look; those whose beams agree with the map are
    chosen, and moved a little. Each then carries the importance weight p(z | x) p(x) / q(x), p(x) being even over the
    free space and q(x) what it was chosen with.

    Parameters
    ----------
    samples_per_m2 : float, 1/m^2, > 0
        How many are looked at where nothing is known: 500 put ten within 0.3 m and 10 degrees of every pose.
    samples_max : int, >= 1
        At most; a million take a second.
    draws : int, >= 1
        How many of them are chosen.
    scale_m : float, m, > 0
        Distance at which a beam agrees by half: as wide as the poses looked at are apart, not as beams are exact.
    concentration : float, >= 0
        log q is this multiple of the inlier ratio.
    jitter_m, jitter_rad : float, m and rad, >= 0
        Standard deviation of the move, half of what the poses looked at are apart.

    References
    ----------
    Probabilistic Robotics, Section 8.3.5 (random particles from the measurement); S. Lenser and M. Veloso,
    Sensor resetting localization for poorly modelled mobile robots, ICRA 2000.
    """

    samples_per_m2: float = bounded(500.0, ge=1e-9, le=1e4)
    samples_max: int = bounded(1_000_000, ge=1, le=10_000_000)
    draws: int = bounded(50_000, ge=1, le=10_000_000)
    scale_m: float = bounded(0.2, ge=1e-6, le=1e6)
    concentration: float = bounded(25.0, ge=0, le=1e6)
    jitter_m: float = bounded(0.05, ge=0, le=1e6)
    jitter_rad: float = bounded(0.03, ge=0, le=100)

    def __call__(
        self, known_map: KnownMap, beams: Beams, log_likelihood: PoseLikelihood, share: float, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Sample a `share` in (0, 1] of all samples from this many poses; poses (K, 3) and log weights (K,).

        The weights are such that their sum is the evidence: the mean of p(z | x) over the free space.
        """
        count = math.ceil(self.draws * share)
        samples = math.ceil(min(self.samples_per_m2 * known_map.free_area_m2, self.samples_max) * share)
        poses = known_map.sample_poses(samples, rng)
        agree = known_map.condition(CauchyEndPoint(scale_m=self.scale_m, tempering=1.0), beams)
        log_q = agree(poses) * (self.concentration / len(beams))
        ends = np.cumsum(np.exp(log_q - log_q.max()))
        chosen = np.minimum(ends.searchsorted(rng.random(count) * ends[-1], side="right"), len(poses) - 1)
        log_mean_q = math.log(ends[-1] / len(poses)) + log_q.max()
        poses = self._moved(known_map, poses[chosen], rng)
        return poses, log_likelihood(poses) + log_mean_q - log_q[chosen] - math.log(count)

    def _moved(self, known_map: KnownMap, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Jitter poses (N, 3), but none out of the free space."""
        moved = poses + rng.normal(size=poses.shape) * [self.jitter_m, self.jitter_m, self.jitter_rad]
        moved[:, 2] = wrap(moved[:, 2])
        return np.where(known_map.is_free(moved)[:, None], moved, poses)
