"""Measures of accuracy: arrays and trajectories in, frozen results out."""

from gridslam.evaluation.consistency import nees
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
)

__all__ = [
    "PoseErrors",
    "RelationErrors",
    "Relations",
    "SelfConsistency",
    "absolute_errors",
    "align",
    "associate",
    "interpolate",
    "measure_self_consistency",
    "nees",
    "relation_errors",
    "relative_errors_by_distance",
]
