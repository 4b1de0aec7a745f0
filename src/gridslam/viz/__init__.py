"""Pictures of maps, trajectories, landmarks and graphs."""

from __future__ import annotations

from gridslam.viz.graph_picture import draw_graph
from gridslam.viz.picture import draw_landmarks, draw_localization, draw_map

__all__ = ["draw_graph", "draw_landmarks", "draw_localization", "draw_map"]
