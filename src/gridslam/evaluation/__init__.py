"""Measures of accuracy: arrays and trajectories in, frozen results out. Each is imported when it is first used."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

_HOMES = {
    "nees": "consistency",
    **dict.fromkeys(("SelfConsistency", "measure_self_consistency"), "self_consistency"),
    **dict.fromkeys(
        (
            "PoseErrors",
            "RelationErrors",
            "Relations",
            "absolute_errors",
            "align",
            "associate",
            "interpolate",
            "relation_errors",
            "relative_errors_by_distance",
        ),
        "trajectory",
    ),
}


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
