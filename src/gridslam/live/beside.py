"""The reference shown beside a finished run: another map, another trajectory, or the truth."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, final

import numpy as np

from gridslam.errors import InputError
from gridslam.evaluation.trajectory import align, associate
from gridslam.geometry.se2 import compose
from gridslam.io.maps import read_map
from gridslam.io.text import stay_below
from gridslam.io.trajectories import read_tum
from gridslam.live.ancestry_tree import NO_POINTS, Float32Array
from gridslam.types import OccupancyGrid, Trajectory

_TRUTH = "truth.tum"


@final
class Beside(NamedTuple):
    """The reference that is shown beside a run, in its map frame.

    Attributes
    ----------
    name : str
        What it is, for the page.
    path : (P, 2) float32, m
        A trajectory; empty if there is none.
    grid : OccupancyGrid or None
        A map; None if there is none.
    """

    name: str
    path: Float32Array
    grid: OccupancyGrid | None


NOTHING = Beside("truth", NO_POINTS, None)
"""No comparison."""


def read_beside(out: Path, other: Path | None, trajectory: Trajectory | None) -> Beside:
    """Read the reference of a run.

    Parameters
    ----------
    out : Path
        The folder of the run; the truth in it, `truth.tum`, is shown unless something else is given.
    other : Path or None
        Another folder with a map, a map's YAML file, or a trajectory's TUM file. A trajectory alone is aligned rigidly
        with the run's by their stamps; a map keeps its frame.
    trajectory : Trajectory or None
        The run's.

    Raises
    ------
    InputError
        There is nothing to read, or no stamp of a trajectory is one of the run's.
    """
    if other is None:
        truth = out / _TRUTH
        is_known = truth.is_file() and trajectory is not None
        with stay_below(out):
            return Beside("truth", _align(truth, trajectory), None) if is_known else NOTHING
    if other.is_dir():
        driven = other / "trajectory.tum"
        with stay_below(other):
            path = read_tum(driven).poses[:, :2].astype(np.float32) if driven.is_file() else NO_POINTS
            return Beside(other.resolve().name, path, read_map(other / "map.yaml"))
    if other.suffix in (".yaml", ".yml"):
        return Beside(other.stem, NO_POINTS, read_map(other))
    return Beside(other.stem, _align(other, trajectory), None)


def _align(path: Path, trajectory: Trajectory | None) -> Float32Array:
    """Read a trajectory and align it with another."""
    read = read_tum(path)
    pairs = (np.zeros(0, np.int64),) * 2 if trajectory is None else associate(trajectory, read)
    if trajectory is None or not len(pairs[0]):
        raise InputError(path, "expected stamps of the run, within 20 ms, got none")
    moved = align(read.poses[pairs[1], :2], trajectory.poses[pairs[0], :2])
    aligned: Float32Array = compose(moved, read.poses)[:, :2].astype(np.float32)
    return aligned
