"""Measures of accuracy: arrays and trajectories in, frozen results out."""

from gridslam.evaluation.closures import closure_errors, false_closures
from gridslam.evaluation.consistency import Consistency, check_consistency, chi_square_quantile, nees
from gridslam.evaluation.maps import MapAgreement, compare_maps
from gridslam.evaluation.self_consistency import SelfConsistency, measure_self_consistency
from gridslam.evaluation.trajectory import (
    PoseErrors,
    RelationErrors,
    Relations,
    absolute_errors,
    align,
    associate,
    interpolate,
    relation_errors,
    relative_errors_by_distance,
    relative_errors_by_step,
)

__all__ = [
    "Consistency",
    "MapAgreement",
    "PoseErrors",
    "RelationErrors",
    "Relations",
    "SelfConsistency",
    "absolute_errors",
    "align",
    "associate",
    "check_consistency",
    "chi_square_quantile",
    "closure_errors",
    "compare_maps",
    "false_closures",
    "interpolate",
    "measure_self_consistency",
    "nees",
    "relation_errors",
    "relative_errors_by_distance",
    "relative_errors_by_step",
]
