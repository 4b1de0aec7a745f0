"""Localization in a known map: by particles on an occupancy grid, and by an EKF on landmarks."""

from gridslam.localization.known_map import KnownMap
from gridslam.localization.monte_carlo import MonteCarloConfiguration, MonteCarloLocalization
from gridslam.localization.state import LocalizationObserver, LocalizationReport, LocalizationSkip, MonteCarloState

__all__ = [
    "KnownMap",
    "LocalizationObserver",
    "LocalizationReport",
    "LocalizationSkip",
    "MonteCarloConfiguration",
    "MonteCarloLocalization",
    "MonteCarloState",
]
