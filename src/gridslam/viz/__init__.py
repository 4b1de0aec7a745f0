"""Pictures of maps, trajectories and graphs."""

from gridslam.viz.graph_picture import draw_graph
from gridslam.viz.picture import draw_map

__all__ = ["draw_graph", "draw_map"]
