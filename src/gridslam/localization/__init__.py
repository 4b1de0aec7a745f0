"""Localization in a known map: by particles on an occupancy grid, and by an EKF on landmarks."""

from gridslam.localization.known_map import KnownMap
from gridslam.localization.monte_carlo import MonteCarloLocalization
from gridslam.localization.monte_carlo_configuration import MonteCarloConfiguration
from gridslam.localization.state import LocalizationObserver, LocalizationReport, LocalizationSkip, MonteCarloState

__all__ = [
    "KnownMap",
    "LocalizationObserver",
    "LocalizationReport",
    "LocalizationSkip",
    "MonteCarloConfiguration",
    "MonteCarloLocalization",
    "MonteCarloState",
]  # fmt: skip
