"""The one loop that drives the filter, offline and live: source -> algorithm -> observers.

A step consumes its state, so one that raises an exception in its midst leaves none. The loop therefore keeps a snapshot
and the measurements since; to go on without the scan that failed, it takes the snapshot and steps through them again.
Where that fails, too, as when memory is short, or where the state is so large that no snapshot of it is kept, the state
is revived as the step has left it.
"""

from __future__ import annotations

import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, Protocol, TypeVar, final, overload

import numpy as np

from gridslam.arguments import describe, require_generator
from gridslam.errors import ArgumentError, GridslamError
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import LaserScan, Odometry, StepReport, describe_time

__all__ = [
    "FailedStep",
    "FailureRecorder",
    "Filter",
    "FilterReport",
    "FilterState",
    "Observer",
    "Stopwatch",
    "describe_error",
    "isolate",
    "run",
]

_CHECKPOINT_RATIO = 128
"""A snapshot is taken after a 128th of all scans, as its tables grow with them, and after the state's own number."""
_CHECKPOINT_BEAMS = 1 << 20
"""Beams of the measurements that are kept since a snapshot, 9 bytes each."""


class FilterState(Protocol):
    """State of a filter.

    Attributes
    ----------
    scans_per_snapshot : int, >= 1
        Number of scans beside which the cost of a snapshot does not count.
    """

    scans_per_snapshot: ClassVar[int]

    @property
    def is_large(self) -> bool:
        """Whether a snapshot that is kept while the filter goes on takes more memory than it is worth."""
        ...

    def snapshot(self: State) -> State:
        """Keep a copy for later; raises ConsumedStateError if a step has consumed the state."""
        ...

    def revive(self) -> None:
        """Make a state whole again that was consumed by a step that failed, and is in part changed by it."""


State = TypeVar("State", bound="FilterState")
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


def describe_error(error: BaseException) -> str:
    """Describe an exception in one line: the text of gridslam's own, of any other its type, text and origin."""
    if isinstance(error, GridslamError):
        return str(error)
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    frames = traceback.extract_tb(error.__traceback__)
    return f"{text} ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else text


def _without_frames(error: Exception) -> Exception:
    """Drop the frames of an exception, which hold what its step has left of the state."""
    error.__context__ = error.__cause__ = None
    return error.with_traceback(None)


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
        The filter's state, which is that before the step; None before the first scan that succeeds.
    """

    scan: LaserScan
    error: Exception
    problem: str
    state: Any

    def __str__(self) -> str:
        """Describe scan and problem in one line."""
        return f"{self.scan.sensor}, scan at {describe_time(self.scan.stamp_ns)}: {self.problem}"


@final
class FailureRecorder:
    """Counts the steps that failed and keeps the first one; to be passed to `run` as `on_failure`."""

    __slots__ = ("_count", "_first")

    def __init__(self) -> None:
        """Start without failures."""
        self._count = 0
        self._first = ""

    def __call__(self, failed: FailedStep) -> None:
        """Record a step that failed."""
        self._count += 1
        self._first = self._first or str(failed)

    def describe(self) -> tuple[str, ...]:
        """Return one sentence on all of them, none without failures."""
        if not self._count:
            return ()
        scans = "1 scan" if self._count == 1 else f"{self._count} scans"
        return (f"{scans} failed and left out: {self._first}",)


def isolate(observer: Callable[..., None], on_failure: Callable[[str], None]) -> Callable[..., None]:
    """Give an observer whose exceptions do not end the run: each is described to `on_failure`."""

    def observe(report: FilterReport, state: FilterState, seconds: float) -> None:
        try:
            observer(report, state, seconds)
        except Exception as error:
            on_failure(describe_error(error))

    return observe


@final
class Stopwatch:
    """Wall and CPU time (s) of the stages of a run; each `lap` ends a stage.

    To read the CPU clock is a system call, which takes longer than many a stage of a single scan. Stages that `split`
    ends only have their wall time measured; the CPU time up to the next lap is divided among them and the stage of the
    lap in proportion to their wall times.

    Parameters
    ----------
    wall_s, cpu_s : float, optional
        `time.perf_counter()` and `time.process_time()` at the start; now if not given.

    Attributes
    ----------
    stages : dict of str to [float, float]
        Wall and CPU seconds by stage, up to the last lap.
    """

    __slots__ = ("_cpu_s", "_splits", "_wall_s", "stages")

    def __init__(self, wall_s: float | None = None, cpu_s: float | None = None) -> None:
        """Start the first stage."""
        self.stages: dict[str, list[float]] = {}
        self._wall_s = time.perf_counter() if wall_s is None else wall_s
        self._cpu_s = time.process_time() if cpu_s is None else cpu_s
        self._splits: list[tuple[str, float]] = []  # since the last lap

    def split(self, stage: str) -> float:
        """End a short stage, to which the wall time since the last one belongs; return its wall seconds."""
        now = time.perf_counter()
        passed_s = now - self._wall_s
        self._wall_s = now
        self._splits.append((stage, passed_s))
        return passed_s

    def lap(self, stage: str) -> float:
        """End a stage, to which the time since the last one belongs; return its wall seconds."""
        passed_s = self.split(stage)
        now = time.process_time()
        wall_s = sum([wall for _, wall in self._splits])
        load = (now - self._cpu_s) / wall_s if wall_s else 0.0
        self._cpu_s = now
        for name, wall in self._splits:
            times = self.stages.get(name)
            if times is None:
                times = self.stages[name] = [0.0, 0.0]
            times[0] += wall
            times[1] += load * wall
        self._splits.clear()
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
    on_failure: Callable[[FailedStep], None] | None = None,
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
    on_failure: Callable[[FailedStep], None] | None = None,
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
    on_failure: Callable[[FailedStep], None] | None = None,
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
    on_failure : callable, optional
        Called with each step that raises an exception: its scan is skipped, without a report, and the next one is
        processed as if there had been no such scan. Where maps take more than 200 MB no copy of the state is kept to
        go back to: what the failed step has written stays, and the state is revived with it. So it is where memory is
        too short to go back. If not given, the exception passes.

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
    watch = stopwatch or Stopwatch()
    checkpoint = None if on_failure is None else _Checkpoint(algorithm, rng)
    first_error: Exception | None = None
    if checkpoint is not None and state is not None:
        checkpoint.keep(state)
    for odometry, scan in _check_measurements(source):
        watch.split("read")
        try:
            if state is None:
                state, report = algorithm.init(odometry, scan, particles)
            else:
                state, report = algorithm.step(state, odometry, scan, rng)
        except Exception as error:
            if checkpoint is None or on_failure is None:
                raise
            problem = describe_error(error)
            failure = _without_frames(error)
        else:
            seconds = watch.split("track" if report.skipped else "step")
            for observe in observers:
                observe(report, state, seconds)
            if checkpoint is not None:
                checkpoint.add(state, odometry, scan)
            watch.lap("observe")
            continue
        first_error = first_error or failure
        state = None if state is None else checkpoint.restore(state)
        on_failure(FailedStep(scan, failure, problem, state))
        watch.lap("step")
    watch.lap("read")
    if state is None:
        raise first_error or ArgumentError("source", "at least one measurement", "none")
    return state


@final
class _Checkpoint(Generic[State]):
    """A snapshot of a filter's state, and the measurements since; nothing of a large state."""

    def __init__(self, algorithm: Filter[State, Any], rng: np.random.Generator) -> None:
        self._algorithm = algorithm
        self._rng = rng
        self._total = 0
        self._state: State | None = None
        self._rng_state: Any = None
        self._since: deque[tuple[Odometry | None, LaserScan]] = deque()
        self._beams = 0

    def add(self, state: State, odometry: Odometry | None, scan: LaserScan) -> None:
        """Keep a measurement that led to this state."""
        self._total += 1
        self._since.append((odometry, scan))
        self._beams += len(scan.ranges)
        due = len(self._since) >= state.scans_per_snapshot and len(self._since) * _CHECKPOINT_RATIO >= self._total
        if self._total == 1 or due or self._beams > _CHECKPOINT_BEAMS:
            self.keep(state)

    def keep(self, state: State) -> None:
        """Take a snapshot, unless the state is large."""
        self._state = None if state.is_large else state.snapshot()
        self._rng_state = self._rng.bit_generator.state
        self._since.clear()
        self._beams = 0

    def restore(self, consumed: State) -> State:
        """Return the state before the step that failed and `consumed` it, exactly, and set back the random generator.

        Where a measurement fails now that did not before, and where there is no snapshot, `consumed` is revived.
        """
        state = self._repeat()
        if state is None:
            state = consumed
            state.revive()
        self.keep(state)  # so that of many failures in a row only the first one takes time
        return state

    def _repeat(self) -> State | None:
        """Step through the measurements since the snapshot again; None where that cannot be done."""
        if self._state is None:
            return None
        now = self._rng.bit_generator.state
        self._rng.bit_generator.state = self._rng_state
        try:
            state = self._state.snapshot()
            for odometry, scan in self._since:
                state, _ = self._algorithm.step(state, odometry, scan, self._rng)
        except Exception:
            self._rng.bit_generator.state = now
            return None
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
