"""The one loop that drives the filter, offline and live: source -> algorithm -> observers.

A step consumes its state. Where it raises an exception in its midst, the loop revives the state that it was given, and
continues without the scan that failed. No copy is kept to return to: it would keep every tile that is written later,
a fifth of all tiles on the Intel log.
"""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar, final

import numpy as np

from gridslam.arguments import describe, require_generator, require_instance
from gridslam.errors import ArgumentError, GridslamError
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import LaserScan, Odometry, StepReport, describe_time


class FilterState(Protocol):
    """State of a filter."""

    def revive(self) -> None:
        """Undo a step that failed: the state is as before it, except for values that the step wrote in place.

        What that is: see the class of the state. The random generator is not set back.
        """


State = TypeVar("State", bound="FilterState")
Report = TypeVar("Report", bound="FilterReport", covariant=True)


class FilterReport(Protocol):
    """Report of a filter on one scan."""

    @property
    def skipped(self) -> object | None:
        """Why the particles were not updated; None if they were."""


class Filter(Protocol[State, Report]):
    """An algorithm that processes measurements one after the other: SLAM, or localization in a known map."""

    @property
    def init(self) -> Callable[..., Any]:
        """Begin; `run` calls it with the first measurement if it is given no state, for the state and the report."""
        ...

    def step(
        self, state: State, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[State, Report]:
        """Process one measurement; consumes `state`."""
        ...


class Observer(Protocol):
    """Called with every scan's report; trajectories, statistics, progress and publishers are observers."""

    def __call__(self, report: StepReport, state: GridFastSlamState, seconds: float) -> None:
        """Process a step that took `seconds`; `state` may be read now, but belongs to the filter."""


def describe_error(error: BaseException) -> str:
    """Describe an exception in one line: the text of gridslam's own, of any other its type, text and origin."""
    if isinstance(error, GridslamError):
        return str(error)
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    frames = traceback.extract_tb(error.__traceback__)
    return f"{text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else text


@final
class FailedStep(NamedTuple):
    """A step that raised an exception; its scan is skipped.

    Attributes
    ----------
    scan : LaserScan
        The scan.
    error : Exception
        The exception, without its traceback.
    problem : str
        Description of the exception.
    state : GridFastSlamState, or the algorithm's own, or None
        The filter's state, revived; None before the first scan that succeeds.
    """

    scan: LaserScan
    error: Exception
    problem: str
    state: Any

    def __str__(self) -> str:
        """Describe scan and problem in one line."""
        return f"{self.scan.sensor}, scan at {describe_time(self.scan.stamp_ns)}: {self.problem}"


@final
@dataclass(slots=True)
class FailureRecorder:
    """Counts the steps that failed and keeps the first one; to be passed to `run` as `on_failure`.

    Attributes
    ----------
    count : int
        Number of them so far.
    first : str
        Description of the first one.
    """

    count: int = 0
    first: str = ""

    def __call__(self, failed: FailedStep) -> None:
        """Record a step that failed."""
        self.count += 1
        self.first = self.first or str(failed)

    def describe(self) -> tuple[str, ...]:
        """Return one sentence on all of them, none without failures."""
        if not self.count:
            return ()
        scans = "1 scan" if self.count == 1 else f"{self.count} scans"
        return (f"{scans} failed and left out: {self.first}",)


def isolate(observer: Callable[..., None], on_failure: Callable[[str], None]) -> Callable[..., None]:
    """Wrap an observer so that its exceptions do not end the run: each is described to `on_failure`."""

    def observe(report: FilterReport, state: FilterState, seconds: float) -> None:
        try:
            observer(report, state, seconds)
        except Exception as error:
            on_failure(describe_error(error))

    return observe


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
        Wall and CPU seconds by stage, up to the last lap.
    """

    __slots__ = ("_cpu_s", "_wall_s", "stages")

    def __init__(self, wall_s: float | None = None, cpu_s: float | None = None) -> None:
        """Start the first stage."""
        self.stages: dict[str, list[float]] = {}
        self._wall_s = time.perf_counter() if wall_s is None else wall_s
        self._cpu_s = time.process_time() if cpu_s is None else cpu_s

    def lap(self, stage: str) -> float:
        """End a stage, to which the time since the last one belongs; return its wall seconds."""
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        passed_s = wall_s - self._wall_s
        times = self.stages.setdefault(stage, [0.0, 0.0])
        times[0] += passed_s
        times[1] += cpu_s - self._cpu_s
        self._wall_s = wall_s
        self._cpu_s = cpu_s
        return passed_s

    def resume(self) -> None:
        """Restart from now; the time since the last lap belongs to no stage."""
        self._wall_s = time.perf_counter()
        self._cpu_s = time.process_time()

    def total(self) -> tuple[float, float]:
        """Return wall and CPU seconds of all stages."""
        times = self.stages.values()
        return sum(wall for wall, _ in times), sum(cpu for _, cpu in times)

    def to_dict(self) -> dict[str, Any]:
        """Return times for run.json: `wall_s` and `cpu_s` of all stages, and of each under `stages`."""
        wall, cpu = self.total()
        stages = {name: {"wall_s": times[0], "cpu_s": times[1]} for name, times in self.stages.items()}
        return {"wall_s": wall, "cpu_s": cpu, "stages": stages}


def run(
    source: Iterable[tuple[Odometry | None, LaserScan]],
    algorithm: Filter[State, Report],
    *,
    rng: np.random.Generator,
    observers: Sequence[Callable[[Report, State, float], None]] = (),
    state: State | None = None,
    stopwatch: Stopwatch | None = None,
    on_failure: Callable[[FailedStep], None] | None = None,
) -> State:
    """Run a filter on all measurements of a source.

    Parameters
    ----------
    source : iterable of (Odometry or None, LaserScan)
        Measurements in chronological order; None if a scan has no odometry.
    algorithm : Filter
        `GridFastSlam`, or any other filter with an initial `state`.
    rng : numpy.random.Generator
        Source of all randomness.
    observers : sequence of Observer
        Called after each step, in this order.
    state : optional
        State to continue from, which is consumed; if not given, the first measurement initializes the filter.
    stopwatch : Stopwatch, optional
        Receives the stages "read" (the source), "track" (scans that did not step the particles), "step" (key scans) and
        "observe".
    on_failure : callable, optional
        Called with each step that raises an exception: its scan is skipped, without a report, and the next one is
        processed with the state as `FilterState.revive` leaves it. If not given, the exception passes.

    Returns
    -------
    GridFastSlamState, or the algorithm's own
        After the last measurement.

    Raises
    ------
    ArgumentError
        The source is empty and there is no state, yields something else than measurements, or has a scan without
        odometry that the tracker requires; `rng` is not a generator.
    Exception
        Of a step, unless `on_failure` is given; of the first step, if all failed.
    """
    require_generator(rng)
    if not callable(getattr(algorithm, "step", None)):
        raise ArgumentError("algorithm", "a filter", describe(algorithm))
    if not (on_failure is None or state is None or callable(getattr(state, "revive", None))):
        raise ArgumentError("state", "the state of a filter", describe(state))
    require_instance("stopwatch", stopwatch, Stopwatch, optional=True)
    watch = stopwatch or Stopwatch()
    first_error: Exception | None = None
    for odometry, scan in _check_measurements(source):
        watch.lap("read")
        try:
            if state is None:
                after: tuple[State, Report] = algorithm.init(odometry, scan)
            else:
                after = algorithm.step(state, odometry, scan, rng)
            state, report = after
        except Exception as error:
            if on_failure is None:
                raise
            problem = describe_error(error)
            error.__context__ = error.__cause__ = None
            failure = error.with_traceback(None)  # frames would keep the state of the step alive
        else:
            seconds = watch.lap("track" if report.skipped else "step")
            for observe in observers:
                observe(report, state, seconds)
            watch.lap("observe")
            continue
        first_error = first_error or failure
        if state is not None:
            state.revive()
        on_failure(FailedStep(scan, failure, problem, state))
        watch.lap("step")
    watch.lap("read")
    if state is None:
        raise first_error or ArgumentError("source", "at least one measurement", "none")
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
