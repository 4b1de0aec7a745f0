"""The models by which logs of landmarks are read, where a call names none."""

from __future__ import annotations

from typing import Final

from gridslam.models.landmark import DepthBearing, LandmarkModel, ObservationKind, RangeBearing, RelativePosition
from gridslam.models.motion import DiffusionMotion

__all__ = ["MOTION", "SENSORS", "WIDE_MOTION"]

SENSORS: Final[dict[ObservationKind, LandmarkModel]] = {
    ObservationKind.RANGE_BEARING: RangeBearing(),
    ObservationKind.DEPTH_BEARING: DepthBearing(),
    ObservationKind.POSITION: RelativePosition(),
}
"""Measurement model of each observation type."""

MOTION: Final = DiffusionMotion(sigma_xy_m=0.02, sigma_theta_rad=0.08)
"""Errors of MRCLAM's commands per metre or radian; logs with covariances do not need it."""

WIDE_MOTION: Final = DiffusionMotion(sigma_xy_m=0.06, sigma_theta_rad=0.12)
"""The same over long intervals, for the gates of data association: the errors of the commands have a bias.

Measured over the 30 intervals of 4 s and more without observations: with `MOTION` their NEES is 13 instead of 3. With
known correspondences the narrow model performs better: particles spread less between observations.
"""
