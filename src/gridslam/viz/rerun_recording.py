"""A run as a recording of Rerun (the extra `rerun`), written to a file or streamed to its viewer."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Iterable, Iterator
from types import TracebackType
from typing import Any, Final, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from gridslam.errors import ConfigurationError, OutputError
from gridslam.geometry.se2 import compose
from gridslam.localization import LocalizationReport, MonteCarloState
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, LaserScan, OccupancyGrid, Odometry, StepReport
from gridslam.viz.canvas import CLOSURE, FAINT, TIME_ENDS, TRUTH
from gridslam.viz.cloud import select_representatives

__all__ = ["RerunRecording"]

_Measured = TypeVar("_Measured", bound="tuple[Odometry | None, LaserScan]")

_KEYS_A_MAP = 10
_SCAN_NS = 100_000_000
_HEIGHT_M: Final = {"path": 0.02, "closures": 0.03, "particles": 0.04, "scan": 0.05}  # what hides what from above


@final
class RerunRecording:
    """Observer that records a run; a context manager, which closes the recording on exit.

    Under ``map`` are the best particle's map and path (after every tenth key scan), the particles (at key scans), the
    scan and the robot (ten times a second of the log); under ``filter`` the effective sample size, the latency and
    whether the robot is lost. Timelines are ``stamp``, the time of the log, and ``scan``, which counts. Where the map
    is known it is there from the beginning, the path has the online poses, broken where the robot was lost, and
    under ``filter`` are the number of particles and the lost probability, too.

    Parameters
    ----------
    target : str
        A file (``run.rrd``), or the address of a viewer: ``127.0.0.1:9876``, or as Rerun writes it,
        ``rerun+http://...``.
    title : str
        What is mapped.
    range_max_m : float, m
        The filter's, beyond which beams are not used.
    known : OccupancyGrid, optional
        The map, where that is known: the filter is one that localizes then.

    Raises
    ------
    ConfigurationError
        Rerun is not installed.
    OutputError
        On entering: the file cannot be written, or the address is none.
    """

    def __init__(
        self, target: str, title: str, *, range_max_m: float = math.inf, known: OccupancyGrid | None = None
    ) -> None:
        try:
            self._rerun: Any = importlib.import_module("rerun")
            self._blueprint: Any = importlib.import_module("rerun.blueprint")
        except ImportError as error:
            raise ConfigurationError(f"Rerun is not there ({error}): pip install 'gridslam[rerun]'") from None
        self._target = target
        self._range_max_m = range_max_m
        self._known = known
        self._recording: Any = self._rerun.RecordingStream(f"gridslam {title}")
        self._scans = 0
        self._due_ns = 0
        self._scan: LaserScan | None = None
        self._begin()

    def __enter__(self) -> RerunRecording:
        """Open the file, or the line to the viewer."""
        recording = self._recording
        target = self._target
        layout = self._layout()
        if re.fullmatch(r"[\w.-]+:\d+|\[[\da-fA-F:]+\]:\d+", target):
            target = f"rerun+http://{target}/proxy"
        try:
            start = recording.connect_grpc if "://" in target else recording.save
            start(target, default_blueprint=layout)
        except (OSError, RuntimeError, ValueError) as error:
            raise OutputError(f"{self._target}: cannot be recorded to: {error}") from None
        recording.log("map", self._rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if self._known is not None:
            self._log_map(self._known, static=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the pending data."""
        if self._known is not None:
            self._log_way()
        self._recording.flush()
        self._recording.disconnect()

    def followed(self, source: Iterable[_Measured]) -> Iterator[_Measured]:
        """Yield the measurements of a source, as they come; the next session of a robot restarts the map."""
        self._begin()
        for measurement in source:
            self._scan = measurement[1]
            yield measurement

    def __call__(self, report: Any, state: Any, seconds: float) -> None:  # noqa: ANN401
        """Record one scan: of a report and a state of SLAM or, where the map is known, of localization."""
        rerun = self._rerun
        log = self._recording.log
        self._scans += 1
        if self._known is None:
            self._closures.extend(report.closures)
        is_key = report.skipped is None
        if not is_key and 0 <= report.stamp_ns - self._due_ns + _SCAN_NS < _SCAN_NS:
            return
        self._due_ns = report.stamp_ns + _SCAN_NS
        self._recording.set_time("scan", sequence=self._scans)
        self._recording.set_time("stamp", timestamp=np.datetime64(report.stamp_ns, "ns"))
        log("filter/latency_ms", rerun.Scalars(1e3 * seconds))
        log("filter/lost", rerun.Scalars(float(report.lost)))
        self._log_robot(report.pose)
        if is_key:
            self._keys += 1
            log("filter/effective_particles", rerun.Scalars(report.n_eff))
            (self._log_slam if self._known is None else self._log_localization)(report, state)

    def finish(self, grid: OccupancyGrid, poses: FloatArray, closures: FloatArray) -> None:
        """Record the final result: the map, poses (T, 3) of the key scans, and ends (C, 4) of the loop closures, m."""
        self._log_map(grid)
        self._strips("path", [poses[:, :2]], TIME_ENDS[1])
        self._strips("closures", closures.reshape(-1, 2, 2), TRUTH)

    def _begin(self) -> None:
        """Begin with a session's first scan."""
        self._keys = 0
        self._closures: list[tuple[int, int]] = []
        self._way: list[list[list[float]]] = [[]]  # where the robot was found

    def _log_slam(self, report: StepReport, state: GridFastSlamState) -> None:
        self._points("particles", state.poses, 0.03, CLOSURE)
        if report.corrected or self._keys % _KEYS_A_MAP == 1:
            self._log_map(state.maps.occupancy(state.best))
            past = state.ancestry.trajectory(state.best)[:, :2]
            self._strips("path", [past], FAINT)
            if self._closures:
                self._strips("closures", past[np.array(self._closures)], TRUTH)

    def _log_localization(self, report: LocalizationReport, state: MonteCarloState) -> None:
        chosen, _ = select_representatives(np.exp(state.log_weights))
        self._points("particles", state.poses[chosen], 0.03, CLOSURE)
        for name, value in (("particles", report.particles), ("doubt", report.lost_probability)):
            self._recording.log(f"filter/{name}", self._rerun.Scalars(value))
        if report.lost:
            self._way.append([])
        else:
            self._way[-1].append(report.pose[:2].tolist())
        if self._keys % _KEYS_A_MAP == 1:
            self._log_way()

    def _log_way(self) -> None:
        """Path of a localized robot, without guesses."""
        self._strips("path", [np.array(strip) for strip in self._way if len(strip) > 1], TIME_ENDS[1])

    def _log_robot(self, pose: FloatArray) -> None:
        x, y, theta = pose.tolist()
        rerun = self._rerun
        heading = rerun.Arrows3D(
            origins=[[x, y, _HEIGHT_M["scan"]]],
            vectors=[[0.6 * math.cos(theta), 0.6 * math.sin(theta), 0.0]],
            radii=0.05,
            colors=[TIME_ENDS[0]],
        )
        self._recording.log("map/robot", heading)
        if self._scan is not None:
            ends = self._scan.beams(0.05, self._range_max_m).ends
            world = compose(pose, np.column_stack([ends, np.zeros(len(ends))]))
            self._points("scan", world, 0.02, TIME_ENDS[1])

    def _log_map(self, grid: OccupancyGrid, *, static: bool = False) -> None:
        rerun = self._rerun
        # as of nav_msgs/OccupancyGrid: -1, and 0 to 100
        cells: NDArray[np.uint8] = np.full(grid.known.shape, 255, np.uint8)
        cells[grid.known] = np.rint(100 * grid.probability[grid.known]).astype(np.uint8)
        height, width = cells.shape
        form = rerun.components.ImageFormat(width=width, height=height, color_model="L", channel_datatype="U8")
        picture = rerun.GridMap(
            data=np.flipud(cells).tobytes(),
            format=form,
            cell_size=grid.resolution_m,
            translation=[*grid.origin, 0.0],
            colormap=rerun.components.Colormap.RvizMap,
        )
        self._recording.log("map/grid", picture, static=static)

    def _points(self, name: str, poses: FloatArray, radius_m: float, colour: tuple[int, int, int]) -> None:
        points = _lift(poses[:, :2], _HEIGHT_M[name])
        self._recording.log(f"map/{name}", self._rerun.Points3D(points, radii=radius_m, colors=[colour]))

    def _strips(self, name: str, strips: Iterable[FloatArray], colour: tuple[int, int, int]) -> None:
        lines = [_lift(strip, _HEIGHT_M[name]) for strip in strips]
        self._recording.log(f"map/{name}", self._rerun.LineStrips3D(lines, radii=0.03, colors=[colour]))

    def _layout(self) -> Any:  # noqa: ANN401
        views = self._blueprint
        names = ["effective_particles", "latency_ms", "lost"] + ([] if self._known is None else ["particles", "doubt"])
        charts = [views.TimeSeriesView(origin=f"filter/{name}") for name in names]
        return views.Blueprint(
            views.Horizontal(views.Spatial3DView(origin="map"), views.Vertical(*charts), column_shares=[3, 1])
        )


def _lift(points: FloatArray, height_m: float) -> NDArray[np.float32]:
    """Return points (K, 2) at a height: (K, 3)."""
    return np.column_stack([points, np.full(len(points), height_m)]).astype(np.float32)
