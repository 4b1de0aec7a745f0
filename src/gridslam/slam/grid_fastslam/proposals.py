"""Proposal distributions and the corresponding importance weights.

A proposal is handed the motion model conditioned on the control and the measurement model conditioned on the scan, and
returns new poses with their log weight increments. The weights are exact for a control from measurements before the
scan that weighs. That of the tracker knows of the scan too, matched to the few scans before it and not to the map.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol, final

import numpy as np

from gridslam.checked import checked
from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.se2 import compose, rotate_covariances
from gridslam.geometry.single_pose import as_pose, is_within
from gridslam.grid.tiles import TileMaps
from gridslam.matching.gauss_newton import EVALUATE_ONLY, GaussNewton
from gridslam.matching.hill_climbing import HillClimbing
from gridslam.parameters import Kind, bounded, parameters
from gridslam.types import BeamEnds, FloatArray, Int32Array, Match, MotionSampler, ScanLikelihood


@final
@dataclass(frozen=True, slots=True, eq=False)
class ProposedPoses:
    """New poses (N, 3), the increments (N,) of their log weights, and the match of the scan at the poses."""

    poses: FloatArray
    log_weights: FloatArray
    match: Match


class Proposal(Protocol):
    """Draws the particles' new poses and weighs them."""

    def __call__(
        self,
        maps: TileMaps,
        poses: FloatArray,
        motion: MotionSampler,
        weigh: ScanLikelihood,
        beams: BeamEnds,
        rng: np.random.Generator,
    ) -> ProposedPoses:
        """Move particles at poses (N, 3), each with its row of `maps`."""
        ...


def _rows(maps: TileMaps) -> Int32Array:
    return np.arange(len(maps), dtype=np.int32)


_LEAST = np.diag([1e-8, 1e-8, 1e-10])
"""Variances (m^2, rad^2) added to those of a motion, so that one without noise along some direction is invertible."""

_STANDSTILL_M = 0.02
_STANDSTILL_RAD = 0.02
"""Where the motion's mean is within both, particles are not matched: a scan at rest has nothing to correct."""


@final
@checked
@parameters(frozen=True)
class MotionModelProposal:
    """Plain FastSLAM: draw from the motion model, weigh by the measurement model.

    x ~ p(x | u, x'), w = p(z | x, m). Exact, and wasteful where the scan is much more certain than the control.

    Source: Probabilistic Robotics, Table 13.4; Haehnel et al. 2003.
    """

    def __call__(
        self,
        maps: TileMaps,
        poses: FloatArray,
        motion: MotionSampler,
        weigh: ScanLikelihood,
        beams: BeamEnds,
        rng: np.random.Generator,
    ) -> ProposedPoses:
        """Move particles at poses (N, 3), each with its row of `maps`."""
        rows = _rows(maps)
        drawn = motion(poses, rng)
        match = EVALUATE_ONLY(maps, rows, drawn, np.zeros((len(rows), 3, 3)), beams)
        return ProposedPoses(drawn, weigh(maps, rows, drawn), match)


@final
@checked
@parameters(frozen=True)
class ScanMatchedProposal:
    """Draw from the motion model, climb to the nearest peak of the posterior, weigh there. The default.

    x ~ p(x | u, x'), x* = the peak that the matcher reaches from x, w = p(z | x*, m). A heuristic, as GMapping does it:
    the density of x* under the proposal is not divided out. It is right to the degree that all particles' peaks are
    equally wide, which one scan seen in nearly equal maps makes them.

    Parameters
    ----------
    matcher : GaussNewton or HillClimbing
        How the peak is reached.
    beam_sigma_m : float, m
        Standard deviation of a beam's distance to the map against which the motion's information holds the match near
        its draw: five times the noise of the motion over a metre, as beams are many and cells coarse.

    References
    ----------
    G. Grisetti, C. Stachniss, W. Burgard, GMapping (OpenSLAM), `GridSlamProcessor::scanMatch`.
    """

    matcher: Annotated[GaussNewton | HillClimbing, Kind()] = GaussNewton()
    beam_sigma_m: float = bounded(0.1, ge=1e-6, le=100)

    def __call__(
        self,
        maps: TileMaps,
        poses: FloatArray,
        motion: MotionSampler,
        weigh: ScanLikelihood,
        beams: BeamEnds,
        rng: np.random.Generator,
    ) -> ProposedPoses:
        """Move particles at poses (N, 3), each with its row of `maps`."""
        rows = _rows(maps)
        drawn = motion(poses, rng)
        means, covariances = motion.moments(poses)
        is_standing = is_within(as_pose(poses[0]), as_pose(means[0]), _STANDSTILL_M, _STANDSTILL_RAD)
        matcher = EVALUATE_ONLY if is_standing else self.matcher
        prior = np.asarray(self.beam_sigma_m**2 * np.linalg.inv(covariances + _LEAST), np.float64)
        match = matcher(maps, rows, drawn, prior, beams)
        return ProposedPoses(match.poses, weigh(maps, rows, match.poses), match)


@final
@checked
@parameters(frozen=True)
class ImprovedProposal:
    """The improved proposal: draw from a Gaussian about the peak of p(z | x, m) p(x | u, x'), weigh by its normalizer.

    x ~ N(x*, C) with C^-1 = H / sigma^2 + P, H the matcher's information and P the motion model's; the weight is
    integral of p(z | x, m) p(x | u, x') dx, by Laplace's method at x*. Both densities must be those of the control
    that the samples are drawn for, so the tempering of the measurement model applies to the whole logarithm.

    Parameters
    ----------
    matcher : GaussNewton
        How the peak is reached, from the motion model's mean.
    beam_sigma_m : float, m
        Standard deviation of a beam's distance to the map; it accounts for the beams' correlation, so it is larger
        than a lidar's noise.

    References
    ----------
    Grisetti, Stachniss and Burgard 2007, eq. 10 to 17; FastSLAM 2.0 (Montemerlo et al. 2003) on grids.
    """

    matcher: GaussNewton = GaussNewton()
    beam_sigma_m: float = bounded(0.02, ge=1e-6, le=100)

    def __call__(
        self,
        maps: TileMaps,
        poses: FloatArray,
        motion: MotionSampler,
        weigh: ScanLikelihood,
        beams: BeamEnds,
        rng: np.random.Generator,
    ) -> ProposedPoses:
        """Move particles at poses (N, 3), each with its row of `maps`."""
        rows = _rows(maps)
        (increment,), (covariance,) = motion.moments(np.zeros((1, 3)))
        means = compose(poses, increment)
        information = np.asarray(np.linalg.inv(covariance + _LEAST), np.float64)  # of the motion, robot frame
        prior = rotate_covariances(information, poses[:, 2])
        match = self.matcher(maps, rows, means, self.beam_sigma_m**2 * prior, beams)
        information = match.information / self.beam_sigma_m**2 + prior
        factor = np.linalg.cholesky(information)
        noise = np.linalg.solve(factor.transpose(0, 2, 1), rng.standard_normal((len(rows), 3, 1)))[..., 0]
        drawn = wrap_headings(match.poses + noise)
        away = wrap_headings(match.poses - means)
        log_prior = -0.5 * np.einsum("ni,nij,nj->n", away, prior, away) + 0.5 * np.linalg.slogdet(prior)[1]
        log_volume = -np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
        return ProposedPoses(drawn, weigh(maps, rows, match.poses) + log_prior + log_volume, match)
