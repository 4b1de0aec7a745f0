"""Results in a session of Python: one line, and a table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from gridslam.errors import MissingDependencyError
from gridslam.io.trajectories import columns_of_trajectory
from gridslam.types import FloatArray, Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = ["describe_result", "tabulate"]


def describe_result(result: object, source: str, caption: Sequence[str]) -> str:
    """One line of a result's class, the log it is of, and the first lines of its caption."""
    return f"{type(result).__name__}({source}: {'; '.join(caption)})"


def tabulate(trajectory: Trajectory, covariances: FloatArray | None = None, **more: ArrayLike) -> DataFrame:
    """A pandas.DataFrame of a trajectory, a row for each pose, with the columns that trajectory.csv has.

    Parameters
    ----------
    trajectory : Trajectory
    covariances : (N, 3, 3) float64, optional
        Of its poses.
    **more : (N,) array
        Further columns.

    Raises
    ------
    MissingDependencyError
        pandas is not installed.
    """
    try:
        import pandas  # only tables pay for its import
    except ImportError:
        raise MissingDependencyError("a table", "pandas", "pandas") from None
    columns = {"stamp_ns": trajectory.stamps_ns} | columns_of_trajectory(trajectory.poses, covariances)
    return pandas.DataFrame(columns | {name: np.asarray(values) for name, values in more.items()})
