"""A piece of a map: key scans and a graph in one frame, which earlier drives have left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple, final

import numpy as np

from gridslam.arguments import Size
from gridslam.grid.tiles import TileMaps
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.slam.loop_closure.constraints import Constraint
from gridslam.slam.loop_closure.key_graph import UNKNOWN_VARIANCES, KeyGraph
from gridslam.slam.loop_closure.scan_archive import ScanArchive
from gridslam.slam.loop_closure.submaps import insert_key_scans
from gridslam.types import FloatArray


@final
@dataclass(frozen=True, slots=True, eq=False)
class MapPiece:
    """The map of earlier drives: all data by which a later drive is relocalized in it and joined with it.

    Of one drive or of several that were joined. Drives follow one another in the order of the key scans, separated by
    an increment of `UNKNOWN_VARIANCES`.

    Attributes
    ----------
    scans : ScanArchive
        All scans, in the order of the drives.
    graph : KeyGraph
        The key scans at their final poses, and the constraints that were accepted.
    """

    scans: Annotated[ScanArchive, Size("T", "keys")]
    graph: Annotated[KeyGraph, "T"]

    def __len__(self) -> int:
        """Return the number of key scans."""
        return len(self.graph)

    def __repr__(self) -> str:
        """Return one line."""
        return f"MapPiece({len(self)} key scans)"

    @property
    def poses(self) -> FloatArray:
        """Poses (T, 3) of the key scans in the piece's map frame."""
        return np.array(self.graph.poses).reshape(-1, 3)

    def build_map(self, mapper: OccupancyGridMapping) -> TileMaps:
        """Draw the piece as one map, drive by drive, in the order of the key scans; see `insert_key_scans`."""
        maps = mapper.empty(1)
        insert_key_scans(maps, self.scans, range(len(self)), self.poses, self.graph)
        return maps

    def freeze(self) -> MapPiece:
        """Return the piece with its key scans fixed: other pieces are aligned with them."""
        graph = self.graph.snapshot()
        graph.frozen = len(self)
        return MapPiece(self.scans, graph)

    def append(self, later: MapPiece, match: PieceMatch) -> MapPiece:
        """Join with a piece that was found in this one; its key scans follow, and the constraints join both."""
        scans = self.scans.snapshot()
        scans.extend(later.scans)
        graph = self.graph.snapshot()
        graph.append(later.graph, match.poses, UNKNOWN_VARIANCES)
        for constraint in match.constraints:
            graph.add(constraint._replace(to=len(self) + constraint.to))
        return MapPiece(scans, graph)


@final
class PieceMatch(NamedTuple):
    """Where a later piece lies in an earlier one.

    Attributes
    ----------
    poses : (K, 3) float64
        Poses of the later piece's key scans in the earlier one's map frame.
    constraints : list of Constraint
        Of key scans of the later piece, `to`, seen from those of the earlier one, `from_`, each counted in its own.
    """

    poses: FloatArray
    constraints: list[Constraint]
