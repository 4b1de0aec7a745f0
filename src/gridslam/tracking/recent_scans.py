"""Scans of the last metres, and the surfaces that they have seen."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, final

import numpy as np

from gridslam.geometry.single_pose import Pose
from gridslam.grid.scan_batch import ScanBatch
from gridslam.matching.surfaces import Surfaces
from gridslam.serialization import NOT_SAVED
from gridslam.types import BeamEnds, FloatArray, StoredScan


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
