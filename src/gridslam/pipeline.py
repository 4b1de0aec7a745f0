"""The one loop that drives the filter, offline and live: source -> algorithm -> observers."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Protocol, TypeVar, final, overload

import numpy as np

from gridslam.arguments import describe, require_generator
from gridslam.errors import ArgumentError
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import LaserScan, Odometry, StepReport

__all__ = ["Filter", "FilterReport", "Observer", "Stopwatch", "run"]

State = TypeVar("State")
Report = TypeVar("Report", bound="FilterReport", covariant=True)


class FilterReport(Protocol):
    """Report of a filter on one scan."""

    @property
    def skipped(self) -> object | None:
        """Why the particles were not updated; None if they were."""


class Filter(Protocol[State, Report]):
    """An algorithm that processes measurements one after the other: SLAM, or localization in a known map."""

    def step(
        self, state: State, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[State, Report]:
        """Process one measurement; consumes `state`."""
        ...


class Observer(Protocol):
    """Called with every scan's report; trajectories, statistics, progress and publishers are observers."""

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Process a step that took `seconds`; `state` may be read now, but belongs to the filter."""


@final
class Stopwatch:
    """Wall and CPU time (s) of the stages of a run; each `lap` ends a stage.

    Parameters
    ----------
    wall_s, cpu_s : float, optional
        `time.perf_counter()` and `time.process_time()` at the start; now if not given.

    Attributes
    ----------
    stages : dict of str to [float, float]
        Wall and CPU seconds by stage.
    """

    __slots__ = ("_last", "stages")

    def __init__(self, wall_s: float | None = None, cpu_s: float | None = None) -> None:
        """Start the first stage."""
        self.stages: dict[str, list[float]] = {}
        self._last = (
            time.perf_counter() if wall_s is None else wall_s,
            time.process_time() if cpu_s is None else cpu_s,
        )

    def lap(self, stage: str) -> float:
        """Add the time since the last lap to `stage`; return its wall seconds."""
        wall_s, cpu_s = self._last
        self.resume()
        passed_s = self._last[0] - wall_s
        times = self.stages.setdefault(stage, [0.0, 0.0])
        times[0] += passed_s
        times[1] += self._last[1] - cpu_s
        return passed_s

    def resume(self) -> None:
        """Restart from now; the time since the last lap belongs to no stage."""
        self._last = time.perf_counter(), time.process_time()

    def total(self) -> tuple[float, float]:
        """Return wall and CPU seconds of all stages."""
        times = self.stages.values()
        return sum(wall for wall, _ in times), sum(cpu for _, cpu in times)

    def to_dict(self) -> dict[str, Any]:
        """Times for run.json: `wall_s` and `cpu_s` of all stages, and of each under `stages`."""
        wall, cpu = self.total()
        stages = {name: {"wall_s": times[0], "cpu_s": times[1]} for name, times in self.stages.items()}
        return {"wall_s": wall, "cpu_s": cpu, "stages": stages}


@overload
def run(
    source: Iterable[tuple[Odometry | None, LaserScan]],
    algorithm: GridFastSlam,
    *,
    particles: int | None = None,
    rng: np.random.Generator,
    observers: Sequence[Observer] = (),
    state: GridFastSlamState | None = None,
    stopwatch: Stopwatch | None = None,
) -> GridFastSlamState: ...


@overload
def run(
    source: Iterable[tuple[Odometry | None, LaserScan]],
    algorithm: Filter[State, Report],
    *,
    rng: np.random.Generator,
    observers: Sequence[Callable[[Report, State, float], None]] = (),
    state: State,
    stopwatch: Stopwatch | None = None,
) -> State: ...


def run(
    source: Iterable[tuple[Odometry | None, LaserScan]],
    algorithm: Any,
    *,
    particles: int | None = None,
    rng: np.random.Generator,
    observers: Sequence[Callable[[Any, Any, float], None]] = (),
    state: Any = None,
    stopwatch: Stopwatch | None = None,
) -> Any:
    """Run a filter on all measurements of a source.

    Parameters
    ----------
    source : iterable of (Odometry or None, LaserScan)
        Measurements in chronological order; None if a scan has no odometry.
    algorithm : Filter
        `GridFastSlam`, or any other filter with an initial `state`.
    particles : int, optional
        Initial number of particles of GridFastSlam without a `state`; its own default if not given.
    rng : numpy.random.Generator
        Source of all randomness.
    observers : sequence of Observer
        Called after each step, in this order.
    state : optional
        State to continue from, which is consumed; if not given, the first measurement initializes the filter.
    stopwatch : Stopwatch, optional
        Receives the stages "read" (the source), "track" (scans that did not step the particles), "step" (key scans) and
        "observe".

    Returns
    -------
    GridFastSlamState, or the algorithm's own
        After the last measurement.

    Raises
    ------
    ArgumentError
        The source is empty and there is no state, yields something else than measurements, or has a scan without
        odometry that the tracker requires; `rng` is not a generator.
    """
    require_generator(rng)
    watch = stopwatch or Stopwatch()
    for odometry, scan in _check_measurements(source):
        watch.lap("read")
        if state is None:
            state, report = algorithm.init(odometry, scan, particles)
        else:
            state, report = algorithm.step(state, odometry, scan, rng)
        seconds = watch.lap("track" if report.skipped else "step")
        for observe in observers:
            observe(report, state, seconds)
        watch.lap("observe")
    watch.lap("read")
    if state is None:
        raise ArgumentError("source", "at least one measurement", "none")
    return state


def _check_measurements(source: object) -> Iterator[tuple[Odometry | None, LaserScan]]:
    """Yield the measurements of a source; raises ArgumentError for a path or a list of scans."""
    expected = "measurements, pairs of odometry and a scan, such as open_log(path) yields"
    if isinstance(source, str) or not isinstance(source, Iterable):
        raise ArgumentError("source", expected, describe(source))
    for measurement in source:
        if not isinstance(measurement, tuple | list) or len(measurement) != 2:
            raise ArgumentError("source", expected, describe(measurement))
        odometry, scan = measurement
        yield odometry, scan
