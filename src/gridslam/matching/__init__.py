"""Scan matching: where does a scan fit a map best, and how well is that determined."""

from gridslam.matching.branch_and_bound import BranchAndBound, LatticeMatch, Pyramid, thin_points
from gridslam.matching.gauss_newton import GaussNewton
from gridslam.matching.hill_climbing import HillClimbing

__all__ = ["BranchAndBound", "GaussNewton", "HillClimbing", "LatticeMatch", "Pyramid", "thin_points"]
