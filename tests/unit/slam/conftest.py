"""A short simulated drive, and how the tests of the trunk play measurements into a filter."""

from __future__ import annotations

from collections.abc import Callable

import checks
import numpy as np
import pytest

from gridslam.sim import SimulatedLog


@pytest.fixture(scope="session")
def drive() -> SimulatedLog:
    """A short drive through an office with poor odometry."""
    return checks.poor_drive()


@pytest.fixture(scope="session")
def play() -> Callable:
    """Play measurements into a filter: the state after the last one, and all reports."""

    def played(slam, measurements, *, particles=5, seed=0, state=None, rng=None):
        rng = rng or np.random.default_rng(seed)
        reports = []
        for odometry, scan in measurements:
            if state is None:
                state, report = slam.init(odometry, scan, particles)
            else:
                state, report = slam.step(state, odometry, scan, rng)
            reports.append(report)
        return state, reports

    return played


@pytest.fixture(scope="session")
def contents() -> Callable:
    """All bytes of a state, by name."""

    def of(state):
        return {name: (str(a.dtype), a.shape, a.tobytes()) for name, a in state.to_arrays().items()}

    return of
