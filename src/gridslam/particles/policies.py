"""Policies: when to step the particles, and when to resample them."""

from __future__ import annotations

import math
from typing import Protocol, final, runtime_checkable

from gridslam.checked import checked
from gridslam.parameters import bounded, parameters


@runtime_checkable
class ResamplingPolicy(Protocol):
    """Decides whether to resample now."""

    def __call__(self, effective_sample_size: float, count: int, needed: int) -> bool:
        """Return whether `count` particles of this effective sample size, in [1, count], are to be resampled.

        The belief needs `needed` of them; where that is not known, it is `count`.
        """
        ...


@runtime_checkable
class UpdatePolicy(Protocol):
    """Decides whether a scan becomes a key scan, at which the particles are stepped."""

    def __call__(self, translation_m: float, rotation_rad: float) -> bool:
        """Return whether the motion since the last key scan (translation >= 0 in m, rotation in rad) calls for one."""
        ...


@final
@checked
@parameters(frozen=True)
class EffectiveSampleSizeBelow:
    """Resample when the effective sample size falls below a part of the number of particles that the belief needs.

    Every resampling costs diversity, and with equal weights it gains nothing (Grisetti et al., T-RO 2007). Resample,
    too, when those needed are fewer than that part of the particles.

    Parameters
    ----------
    fraction : float in (0, 1], of the number of particles
        0.5 is the value of that paper and of GMapping: half the particles carry next to nothing by then.
    """

    fraction: float = bounded(0.5, ge=1e-12, le=1)

    def __call__(self, effective_sample_size: float, count: int, needed: int) -> bool:
        """Return whether the effective sample size is below `fraction` * `needed`, or `needed` so far below `count`."""
        return effective_sample_size < self.fraction * needed or needed < self.fraction * count


@final
@checked
@parameters(frozen=True)
class AlwaysResample:
    """Resample at every key scan, as in the textbook's particle filter (Probabilistic Robotics, Table 4.3)."""

    def __call__(self, effective_sample_size: float, count: int, needed: int) -> bool:
        """Return True."""
        return True


@final
@checked
@parameters(frozen=True)
class NeverResample:
    """Never resample: sequential importance sampling, whose weights degenerate; for study and for tests."""

    def __call__(self, effective_sample_size: float, count: int, needed: int) -> bool:
        """Return False."""
        return False


@final
@checked
@parameters(frozen=True)
class MotionThreshold:
    """A scan is a key scan once the robot has moved or turned enough since the last one.

    Scans from nearly one place see the same surfaces with the same error: counted as independent, they make the
    weights overconfident. Scans too far apart overlap too little to be matched.

    Parameters
    ----------
    translation_m : float > 0, m
        0.5: ten cells of a grid of 5 cm, while neighbouring scans still see nearly the same walls.
    rotation_rad : float > 0, rad
        0.5 (29 degrees): a laser that sees half the plane still keeps five sixths of its view.
    """

    translation_m: float = bounded(0.5, ge=1e-12, le=math.inf, allow_inf_nan=True)
    rotation_rad: float = bounded(0.5, ge=1e-12, le=math.inf, allow_inf_nan=True)

    def __call__(self, translation_m: float, rotation_rad: float) -> bool:
        """Return whether the translation (m) or the magnitude of the rotation (rad) has reached its threshold."""
        return translation_m >= self.translation_m or abs(rotation_rad) >= self.rotation_rad
