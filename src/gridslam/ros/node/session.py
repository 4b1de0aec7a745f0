"""One session of a filter that localizes: from its first scan until a reset or the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, final

import numpy as np

from gridslam.io.measurement import Measurement
from gridslam.localization import (
    KnownMap,
    LocalizationReport,
    MonteCarloConfiguration,
    MonteCarloLocalization,
    MonteCarloState,
)
from gridslam.pipeline import FailedStep, run
from gridslam.types import FloatArray, LaserScan, Odometry

FailureCallback: TypeAlias = Callable[[FailedStep], None]
"""Called with each step that failed."""

InitialPose: TypeAlias = tuple[FloatArray, FloatArray] | None
"""A pose (3,) and its covariance (3, 3); None if the pose is unknown."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class Localization:
    """Map, filter and initial pose of a localization.

    Attributes
    ----------
    known : KnownMap
        The map.
    configuration : MonteCarloConfiguration
        Configuration of the filter.
    initial_pose : (pose (3,), covariance (3, 3)) or None
        Initial pose; None: global localization.
    """

    known: KnownMap
    configuration: MonteCarloConfiguration
    initial_pose: InitialPose = None

    @property
    def range_max_m(self) -> float:
        """Range from which beams are ignored, m."""
        return self.configuration.range_max_m


@final
class LocalizationSession:
    """A localization session; used by the filter's thread only.

    Parameters
    ----------
    localization : Localization
        Map and filter.
    seed : int
        Seed of the filter.
    """

    restart_message = "localization restarts"

    def __init__(self, localization: Localization, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._mcl = MonteCarloLocalization(localization.known, localization.configuration)
        self.init = self._mcl.init
        self.state = self._make_state(localization.initial_pose)
        self._next_state: MonteCarloState | None = None

    def set_pose(self, pose: InitialPose) -> None:
        """Set the pose from the next scan on; None: the pose is unknown."""
        self._next_state = self._make_state(pose)

    def run(self, source: Iterator[Measurement], observers: Sequence[Any], on_failure: FailureCallback) -> None:
        """Run the filter on all measurements of a source; scans at which it fails are skipped."""
        run(source, self, rng=self._rng, observers=observers, state=self.state, on_failure=on_failure)

    def step(
        self, state: MonteCarloState, odometry: Odometry | None, scan: LaserScan, rng: np.random.Generator
    ) -> tuple[MonteCarloState, LocalizationReport]:
        """Process a measurement, from the pose that was set since the last scan if there is one."""
        begin = state if self._next_state is None else self._next_state.snapshot()
        self.state, report = self._mcl.step(begin, odometry, scan, rng)
        self._next_state = None
        return self.state, report

    def _make_state(self, pose: InitialPose) -> MonteCarloState:
        return self._mcl.init() if pose is None else self._mcl.init_gaussian(*pose, self._rng)
