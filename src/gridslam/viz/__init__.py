"""Pictures of maps, trajectories, landmarks and graphs; Pillow is imported when the first one is drawn."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gridslam.viz.graph_picture import draw_graph
    from gridslam.viz.picture import draw_landmarks, draw_localization, draw_map

__all__ = ["draw_graph", "draw_landmarks", "draw_localization", "draw_map"]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{'graph_picture' if name == 'draw_graph' else 'picture'}"), name)
