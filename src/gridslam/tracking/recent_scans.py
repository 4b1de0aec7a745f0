"""Scans of the last metres, and the surfaces that they have seen: a match to these is exacter than one to cells."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, final

import numpy as np

from gridslam.geometry.single_pose import Pose
from gridslam.grid.scan_batch import ScanBatch
from gridslam.kernels import backend
from gridslam.matching.surfaces import LEAST_INFORMATION, Surfaces
from gridslam.serialization import NOT_SAVED
from gridslam.types import BeamEnds, FloatArray, StoredScan

_GATES_M = np.array([0.15, 0.08])
"""Largest residual of a point, in each step: a match to cells of 5 cm is off by less than the first."""
_MIN_POINTS = 20
_MAX_CORRECTION_M = 0.1
"""Where fewer points are matched, or the scan would move farther, it stays."""
_PRIOR = 1 / np.square([0.02, 0.02, 0.01])
"""Information of the match to the map, from standard deviations in m, m, rad."""
SURFACE_SCANS = 4
"""How many scans of the last metres: with eight the tracker drifts as fast, at twice the cost of a match."""
_SIGMA_M = 0.02
"""Standard deviation of a point; where the residual is as large, it weighs half."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class RecentScan:
    """Ends of beams (B, 2) and the laser's place (2,), base frame, of a scan that was taken at `pose`."""

    ends: Annotated[FloatArray, None, 2]
    origin: Annotated[FloatArray, 2]
    pose: Pose


@final
@dataclass(slots=True, eq=False)
class RecentScans:
    """Scans of the last metres in the local map, oldest first; replaced as a whole, never changed."""

    scans: list[RecentScan] = field(default_factory=list)
    fitted: Surfaces | None = field(default=None, metadata=NOT_SAVED)
    poses: FloatArray = field(init=False, metadata=NOT_SAVED)

    def __post_init__(self) -> None:
        """Put the poses (S, 3) side by side."""
        self.poses = np.array([scan.pose for scan in self.scans], np.float64).reshape(-1, 3)

    @property
    def surfaces(self) -> Surfaces:
        """Their surfaces."""
        if self.fitted is None:
            self.fitted = Surfaces.of(ScanBatch.of([StoredScan(scan.ends, scan.origin) for scan in self.scans]))
        return self.fitted

    def insert(self, beams: BeamEnds, pose: Pose, most: int) -> RecentScans:
        """Add a scan, fit its surfaces, and leave out the oldest beyond `most`."""
        kept = most - 1
        scan = RecentScan(beams.ends, np.asarray(beams.origin, np.float64), pose)
        before = self.surfaces.of_scans(max(len(self.scans) - kept, 0))
        own = Surfaces.of(ScanBatch.of([beams]))
        return RecentScans([*self.scans[-kept:], scan], before.append(own))

    def match(self, ends: FloatArray, guess: Pose) -> Pose:
        """Move a scan that was matched to a map to where the ends of its beams (B, 2) fit the surfaces.

        Point to line, by Gauss-Newton. A map keeps cells, and errors of centimetres with them: matched to surfaces the
        tracker drifts a third as fast. Where few points fit, and along directions that surfaces leave open, the pose
        stays.

        References
        ----------
        Chen and Medioni, Object modelling by registration of multiple range images (1992); Censi, An ICP variant using
        a point-to-line metric (2008).
        """
        settings = _PRIOR, _GATES_M, _SIGMA_M, LEAST_INFORMATION
        pose, count = backend.match_to_surfaces(*self.surfaces, self.poses, ends, guess, *settings)
        is_near = math.hypot(pose[0] - guess[0], pose[1] - guess[1]) < _MAX_CORRECTION_M
        return pose if count >= _MIN_POINTS and is_near else guess
