"""One sweep of a planar lidar: where its beams point, what they measured, and which of them are used.

`gridslam.types` has these names beside the other values.
"""

from gridslam.scan.arrays import FloatArray, IntArray, Rows
from gridslam.scan.beams import BeamEnds, Beams, StoredScan
from gridslam.scan.geometry import ScanGeometry
from gridslam.scan.laser_scan import LONGEST_SCAN_S, BeamStatus, LaserScan
from gridslam.scan.thinning import Thinning

__all__ = [
    "LONGEST_SCAN_S",
    "BeamEnds",
    "BeamStatus",
    "Beams",
    "FloatArray",
    "IntArray",
    "LaserScan",
    "Rows",
    "ScanGeometry",
    "StoredScan",
    "Thinning",
]  # fmt: skip
