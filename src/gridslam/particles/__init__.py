"""The belief as weighted particles: weights, resampling, policies, ancestry and the first draw."""

from gridslam.particles.ancestry import Ancestry
from gridslam.particles.initial import repeat_pose, sample_gaussian
from gridslam.particles.kld_sampling import kld_bound
from gridslam.particles.policies import (
    AlwaysResample,
    EffectiveSampleSizeBelow,
    MotionThreshold,
    NeverResample,
    ResamplingPolicy,
    UpdatePolicy,
)
from gridslam.particles.resampling import (
    Multinomial,
    ResamplingWheel,
    Residual,
    Stratified,
    Systematic,
    effective_sample_size,
    entropy,
    normalize,
)

__all__ = [
    "AlwaysResample",
    "Ancestry",
    "EffectiveSampleSizeBelow",
    "MotionThreshold",
    "Multinomial",
    "NeverResample",
    "ResamplingPolicy",
    "ResamplingWheel",
    "Residual",
    "Stratified",
    "Systematic",
    "UpdatePolicy",
    "effective_sample_size",
    "entropy",
    "kld_bound",
    "normalize",
    "repeat_pose",
    "sample_gaussian",
]
