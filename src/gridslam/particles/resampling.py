"""Resampling: which particles survive. Five ways to draw indices with the same expectation, differing in variance.

Each resampler is called as ``resampler(weights, size, rng)`` and follows one contract (`gridslam.types.Resampler`):

- `weights` (N,) float64 are finite, >= 0 and not all 0, of any scale; `size` >= 0 need not equal N;
- it returns `size` indices, int64, ascending; index i comes up size * weights[i] / sum(weights) times on average;
- a particle of weight 0 is never drawn;
- it raises ArgumentError if the weights or the size are anything else.

All but `Residual` are the same picture: the weights are laid end to end on a line or circle, and points of uniform
distribution are put on it. They differ only in how the points depend on each other.
"""

from __future__ import annotations

import math
from typing import Annotated, final

import numpy as np

from gridslam.arguments import Limits, require_generator
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap_headings
from gridslam.parameters import parameters
from gridslam.types import FloatArray, IntArray

_Weights = Annotated[FloatArray, "N"]
_Count = Annotated[int, Limits(0, 1 << 30)]


@checked
def normalize(log_weights: FloatArray) -> FloatArray:
    """Shift log weights so that the weights sum to 1.

    Parameters
    ----------
    log_weights : (N,) float64, nats
        Below +inf; -inf is a weight of 0.

    Returns
    -------
    (N,) float64, nats
        log_weights - log(sum(exp(log_weights))), computed about the greatest, so that no range is too wide.

    Raises
    ------
    ArgumentError
        If there is no weight, one is NaN or +inf, or all are -inf: then the belief is empty and cannot be repaired.
    """
    weights, shifted = _exponentiate(log_weights)
    return np.asarray(shifted - np.log(weights.sum()))


@checked
def effective_sample_size(log_weights: FloatArray) -> float:
    """Return effective sample size 1 / sum(w^2) of the normalized weights.

    From 1, where one particle holds all, to N, where all are equal. `log_weights` (N,) need not be normalized; raises
    as `normalize` does.

    Source: Liu, Metropolized independent sampling with comparisons to rejection sampling and importance sampling
    (1996); used for selective resampling by Grisetti et al. (T-RO 2007).
    """
    weights, _ = _exponentiate(log_weights)
    return float(weights.sum() ** 2 / np.square(weights).sum())


@checked
def entropy(log_weights: FloatArray) -> float:
    """Shannon entropy of the normalized weights in nats, from 0 (one particle holds all) to log(N) (all are equal).

    `log_weights` (N,) need not be normalized; raises as `normalize` does.
    """
    weights, shifted = _exponentiate(log_weights)
    total = weights.sum()
    drawn = weights > 0
    return float(np.log(total) - weights[drawn] @ shifted[drawn] / total)


def compute_spread(poses: FloatArray, log_weights: FloatArray, best: int) -> FloatArray:
    """Return the weighted covariance (3, 3) of particles (N, 3), normalized log weights (N,), about the best one."""
    away = wrap_headings(poses - poses[best])
    return np.asarray((np.exp(log_weights) * away.T) @ away)


def require_log_weights(log_weights: FloatArray) -> None:
    """Reject log weights (N,), N >= 1, that are NaN or infinite, or all of weight zero."""
    greatest = float(log_weights.max())
    if not math.isfinite(greatest):
        raise ArgumentError("log_weights", "no NaN, none +inf and not all -inf", f"a greatest value of {greatest}")


def _exponentiate(log_weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return weights relative to the greatest, and their logarithms."""
    given = np.asarray(log_weights, dtype=np.float64)
    if given.ndim != 1 or len(given) == 0:
        raise ArgumentError("log_weights", "shape (N,) with N >= 1", given.shape)
    require_log_weights(given)
    greatest = float(given.max())
    with np.errstate(over="ignore"):  # a difference beyond the number range is a weight of 0 all the same
        shifted = given - greatest
    return np.exp(shifted), shifted


@final
@checked
@parameters(frozen=True)
class Systematic:
    """Low variance resampling: one random number, then points at equal distances.

    A particle comes up floor or ceil of size * weight times; all particles survive equal weights.

    Source: Probabilistic Robotics, Table 4.4.
    """

    def __call__(self, weights: _Weights, size: _Count, rng: np.random.Generator) -> IntArray:
        """Draw `size` ascending indices of `weights` (N,); see the contract of the module."""
        ends = np.cumsum(_relative(weights, rng))
        return _slots(ends, (rng.random() + np.arange(size)) * (ends[-1] / max(size, 1)))


@final
@checked
@parameters(frozen=True)
class Stratified:
    """One point, uniform and independent, in each of `size` equal sections of the line.

    Source: Kitagawa, Monte Carlo filter and smoother for non-Gaussian nonlinear state space models (1996).
    """

    def __call__(self, weights: _Weights, size: _Count, rng: np.random.Generator) -> IntArray:
        """Draw `size` ascending indices of `weights` (N,); see the contract of the module."""
        ends = np.cumsum(_relative(weights, rng))
        return _slots(ends, (rng.random(size) + np.arange(size)) * (ends[-1] / max(size, 1)))


@final
@checked
@parameters(frozen=True)
class Multinomial:
    """Independent points: counts have the multinomial distribution, the yardstick for the others' variance.

    Source: Gordon, Salmond and Smith, Novel approach to nonlinear/non-Gaussian Bayesian state estimation (1993).
    """

    def __call__(self, weights: _Weights, size: _Count, rng: np.random.Generator) -> IntArray:
        """Draw `size` ascending indices of `weights` (N,); see the contract of the module."""
        ends = np.cumsum(_relative(weights, rng))
        return _slots(ends, np.sort(rng.random(size)) * ends[-1])


@final
@checked
@parameters(frozen=True)
class Residual:
    """Each particle floor(size * weight) times for certain, the rest multinomially from the remainders.

    Source: Liu and Chen, Sequential Monte Carlo methods for dynamic systems (1998).
    """

    def __call__(self, weights: _Weights, size: _Count, rng: np.random.Generator) -> IntArray:
        """Draw `size` ascending indices of `weights` (N,); see the contract of the module."""
        relative = _relative(weights, rng)
        expected = relative * size / relative.sum()
        counts = np.floor(expected).astype(np.int64)
        rest = size - int(counts.sum())
        if rest > 0:
            drawn = Multinomial()(expected - counts, rest, rng)
            counts += np.bincount(drawn, minlength=len(counts))
        return np.repeat(np.arange(len(counts), dtype=np.int64), counts)


@final
@checked
@parameters(frozen=True)
class ResamplingWheel:
    """The wheel of weights, turned by uniform steps of up to twice the greatest weight; each stop draws a particle.

    As usually taught the wheel starts at the *beginning of a random slot*, all slots being equally likely, and that is
    biased. Take two particles of weights 0.9 and 0.1, so steps are uniform in [0, 1.8). From the beginning of the first
    slot the first stop falls into the second one with probability 0.1 / 1.8, from that of the second (stops in
    [0, 0.1) and, once around, [1, 1.1)) with 0.2 / 1.8; together 1/12, where it ought to be 1/10. A small particle is
    as likely a start as a great one, and what lies just behind a great one is stepped over.

    Here the wheel starts at a point *uniform on the circumference*. A uniform point on a circle, moved by a step
    independent of it, is uniform again; so every single stop is uniform, whatever the steps, and draws particle i with
    probability weights[i] / sum(weights): the expected counts are right. Where `size` is not N the steps are scaled by
    N / size, so that the walk goes around equally far.

    Source: Thrun, Artificial Intelligence for Robotics (lecture on particle filters), with the start corrected.
    """

    def __call__(self, weights: _Weights, size: _Count, rng: np.random.Generator) -> IntArray:
        """Draw `size` ascending indices of `weights` (N,); see the contract of the module."""
        relative = _relative(weights, rng)
        ends = np.cumsum(relative)
        start = rng.random() * ends[-1]
        steps = rng.random(size) * (2.0 * len(relative) / max(size, 1))  # the greatest weight is 1
        return _slots(ends, np.sort(np.mod(start + np.cumsum(steps), ends[-1])))


def _relative(weights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Weights divided by the greatest: subnormal and huge ones add up safely, and sums of equal ones are exact."""
    require_generator(rng)
    given = np.asarray(weights, dtype=np.float64)
    if given.ndim != 1 or len(given) == 0:
        raise ArgumentError("weights", "shape (N,) with N >= 1", given.shape)
    greatest = given.max()
    if not (given.min() >= 0 and 0 < greatest < np.inf):
        raise ArgumentError("weights", "finite values >= 0, not all 0", f"values from {given.min()} to {greatest}")
    return np.asarray(given / greatest)


def _slots(ends: FloatArray, points: FloatArray) -> IntArray:
    """Return the slots that contain ascending points.

    Slots [end of the one before, end) are half open, so an empty one (weight 0) holds no point.
    """
    below_the_end = np.minimum(points, np.nextafter(ends[-1], 0.0))  # rounding may put the last point onto the end
    return np.asarray(ends.searchsorted(below_the_end, side="right"), np.int64)
