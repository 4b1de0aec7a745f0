"""Several sessions as one map: `gridslam merge`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, final

import numpy as np

from gridslam import __version__
from gridslam.api.result import Result, write_trajectory
from gridslam.api.session import Session
from gridslam.errors import ArgumentError
from gridslam.io.g2o import write_g2o
from gridslam.io.maps import write_map
from gridslam.io.output import OutputFolder
from gridslam.io.trajectories import write_tum
from gridslam.parameters import to_table
from gridslam.pipeline import Stopwatch
from gridslam.slam.full_slam.full_slam import FullSlam
from gridslam.types import FloatArray, Trajectory
from gridslam.viz import draw_map
from gridslam.viz.notebook import Picture


@final
@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class MergeResult(Result):
    """Sessions that were merged.

    Attributes
    ----------
    session : Session
        The merged session, which can be saved.
    sources : tuple of Path
        The session files.
    trajectory : Trajectory
        Of all drives of the largest piece, by their stamps.
    covariances : (N, 3, 3) float64
        Of its poses, by x, y in m and theta in rad, map frame, given that the first pose of the first drive is exact.
    full : FullSlam
        The full SLAM answer of that piece.
    is_joined : bool
        Whether any sessions have something in common.
    """

    schema: ClassVar = "gridslam.merge/1"
    picture_name: ClassVar = "map.png"
    file_names: ClassVar = ("map.yaml", "map.pgm", "trajectory.tum", "trajectory.csv", "graph.g2o")

    session: Session
    sources: tuple[Path, ...]
    trajectory: Trajectory
    covariances: FloatArray
    full: FullSlam
    is_joined: bool

    @property
    def source(self) -> Path:
        """The first session file."""
        return self.sources[0]

    @property
    def trajectories(self) -> dict[str, Trajectory]:
        """The trajectory of each drive of the largest piece, by its name."""
        names = {drive.name for drive in self.session.pieces[0].drives}
        return {name: path for name, path in self.session.trajectories.items() if name in names}

    @property
    def apart(self) -> list[list[str]]:
        """Names of the drives of each piece that has nothing in common with the largest one."""
        return [[drive.name for drive in piece.drives] for piece in self.session.pieces[1:]]

    def caption(self) -> list[str]:
        """Return lines that describe the map."""
        grid = self.full.tiled_map
        height, width = (side * grid.resolution_m for side in grid.shape)
        drives = len(self.session.pieces[0].drives)
        apart = f", {len(self.apart)} pieces apart" if self.apart else ""
        return [
            f"{drives} drive{'s' * (drives != 1)} of {len(self.sources)} sessions{apart}, {len(self.trajectory)} scans",
            f"{width:.0f} m x {height:.0f} m in cells of {100 * grid.resolution_m:g} cm: gridslam {__version__}",
        ]

    def picture(self) -> Picture:
        """Picture of the map, with the trajectory of each drive in a colour of its own."""
        return draw_map(
            self.full.tiled_map,
            self.trajectories,
            title=" + ".join(path.name for path in self.sources),
            caption=self.caption(),
        )

    def _write_files(self, out: OutputFolder) -> None:
        write_map(out.file("map.yaml"), self.full.tiled_map)
        write_trajectory(out, self.trajectory, self.covariances)
        for name, trajectory in self.session.trajectories.items():
            write_tum(out.file(f"trajectory_{name}.tum"), trajectory)
        for number, grid in enumerate(self.session.maps[1:], start=2):
            write_map(out.file(f"map_{number}.yaml"), grid)
        write_g2o(out.file("graph.g2o"), self.full.graph)

    def _describe(self) -> dict[str, Any]:
        loops = self.full.loop_summary
        pieces = [
            [{"name": drive.name, "logs": [asdict(log) for log in drive.logs]} for drive in piece.drives]
            for piece in self.session.pieces
        ]
        return {
            "inputs": [str(path) for path in self.sources],
            "joined": self.is_joined,
            "pieces": pieces,
            "scans": len(self.trajectory),
            "key_scans": len(self.full.graph.poses),
            "closures": 0 if loops is None else len(loops.closures),
            "configuration": to_table(self.session.configuration),
        }


def merge_sessions(
    paths: Sequence[str | Path],
    *,
    threads: int = 1,
    on_progress: Callable[[], None] = lambda: None,
    stopwatch: Stopwatch | None = None,
) -> MergeResult:
    """Merge session files of several robots or days into one map; the order of the files changes nothing.

    Parameters
    ----------
    paths : sequence of str or Path
        Two or more.
    threads : int, >= 1
        Threads of the kernels; never changes a result.
    on_progress : callable
        Called periodically.
    stopwatch : Stopwatch, optional
        A stopwatch to continue.

    Raises
    ------
    ArgumentError
        There are fewer than two files, the same twice, or sessions of different configurations.
    InputError
        A file is no session.
    """
    files = sorted(Path(path) for path in paths)
    if len({file.resolve() for file in files}) < max(len(files), 2):
        raise ArgumentError("paths", "two or more files, each of them once", [str(file) for file in files])
    watch = stopwatch or Stopwatch()
    first, *others = [Session.open(file, threads=threads) for file in files]
    watch.lap("read")
    pieces = sum(len(session.pieces) for session in (first, *others))
    full = first.merge(*others, on_progress=on_progress)
    watch.lap("merge")
    stamps_ns = first.pieces[0].stamps_ns
    order = np.argsort(stamps_ns, kind="stable")
    return MergeResult(
        session=first,
        sources=tuple(files),
        trajectory=Trajectory(stamps_ns[order], full.poses[order]),
        covariances=full.covariances[order],
        full=full,
        is_joined=len(first.pieces) < pieces,
        stopwatch=watch,
    )
