"""Sources of a plan: a map_server map, or the folder of a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, final

import numpy as np

from gridslam.doctor.repair import open_repaired
from gridslam.geometry import se2
from gridslam.io.edits import read_edits
from gridslam.io.maps import read_map
from gridslam.io.text import compute_digest, read_json
from gridslam.io.trajectories import read_tum
from gridslam.mapping.known_poses import KnownPoses
from gridslam.plan.surfaces import SurfacePoints, points_of_grid, points_of_scans
from gridslam.types import FloatArray, OccupancyGrid

_NEAREST_M = 0.05
_FARTHEST_M = 30.0


@final
class MapSource(NamedTuple):
    """A map, and the name that a plan of it has.

    With scans their surface points, and where the laser was (P, 2); with edits beside it names of rooms, each with a
    place (2,).
    """

    grid: OccupancyGrid
    name: str
    points: SurfacePoints | None = None
    path: FloatArray | None = None
    names: tuple[tuple[str, FloatArray], ...] = ()

    @property
    def surfaces(self) -> SurfacePoints:
        """Points on walls: of the scans, or without any of the map's cells."""
        return points_of_grid(self.grid) if self.points is None else self.points


def read_source(path: str | Path, on_remark: Callable[[str], None] = lambda remark: None) -> MapSource:
    """Read the source of a plan.

    Parameters
    ----------
    path : str or Path
        A map's YAML file, the folder OUT of `gridslam map` or `grid`.
    on_remark : callable
        Gets what is odd, a sentence each; so, that walls are taken from cells, as a folder's log is not there.

    Raises
    ------
    InputError
        Nothing of these is there, or it cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        source, edits = _read_folder(path, on_remark), path / "edits.geojson"
    else:
        source, edits = MapSource(read_map(path, on_remark=on_remark), path.stem), path.with_name("edits.geojson")
    rooms = read_edits(edits).of("rooms") if edits.is_file() else []
    return source._replace(names=tuple((room.name, room.points.mean(axis=0)) for room in rooms))


def _read_folder(out: Path, on_remark: Callable[[str], None]) -> MapSource:
    """The map of a run, and the end points of its log, if that is still where it was, or beside OUT, or in it."""
    grid = read_map(out / "map.yaml", on_remark=on_remark)
    name = out.resolve().name
    document = read_json(out / "run.json") if (out / "run.json").is_file() else {}
    source = document.get("input")
    log = _find_log(out, source) if isinstance(source, dict) else None
    if log is None or not (out / "trajectory.tum").is_file():
        on_remark(f"{out}: the log or the trajectory of this run is not there: walls are taken from its map")
        return MapSource(grid, name)
    poses = KnownPoses(read_tum(out / "trajectory.tum"))
    path: list[FloatArray] = []

    def scans() -> Iterator[tuple[FloatArray, FloatArray]]:
        for _, scan in open_repaired(log, None, "needed"):
            pose = poses.at(scan.stamp_ns)
            if isinstance(pose, np.ndarray):
                beams = poses.deskew(scan.beams(_NEAREST_M, _FARTHEST_M))
                path.append(se2.transform_points(pose, beams.origin[None])[0])
                yield path[-1], se2.transform_points(pose, beams.ends)

    points = points_of_scans(scans(), grid.resolution_m)
    return MapSource(grid, name, points, np.array(path)) if len(points) else MapSource(grid, name)


def _find_log(out: Path, source: dict[str, Any]) -> Path | None:
    """Where the log of a run is: one with the digest that the run has recorded."""
    recorded = Path(str(source.get("path") or ""))
    for path in (recorded, out / recorded.name, out.resolve().parent / recorded.name):
        is_log = recorded.name and (path.is_file() or (path / "metadata.yaml").is_file())
        if is_log and compute_digest(path) == source.get("sha256"):
            return path
    return None
