"""Data association, which SLAM shares with localization: see `gridslam.models.association`."""

from __future__ import annotations

from gridslam.models.association import AMBIGUOUS, NEW, Association, MaximumLikelihood, Told, signatures

__all__ = ["AMBIGUOUS", "NEW", "Association", "MaximumLikelihood", "Told", "signatures"]
