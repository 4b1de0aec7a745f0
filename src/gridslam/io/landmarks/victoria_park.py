"""Landmark logs in the form of GTSAM's Victoria Park file: increments and positions of landmarks, each with noise."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import final

import numpy as np

from gridslam.errors import InputError
from gridslam.io.landmarks.log import LandmarkLogStatistics, LandmarkTruth
from gridslam.io.number_rows import read_numbered_lines
from gridslam.models.landmark import LandmarkObservations, LandmarkStep, ObservationKind
from gridslam.types import FloatArray

__all__ = ["VictoriaParkLog"]

_ODOMETRY, _LANDMARK = "ODOMETRY", "LANDMARK"
_COLUMNS = {
    _ODOMETRY: "from to x_m y_m theta_rad xx xy xt yy yt tt",
    _LANDMARK: "pose landmark x_m y_m xx xy yy",
}
_FULL = {2: [0, 1, 1, 2], 3: [0, 1, 2, 1, 3, 4, 2, 4, 5]}  # entries of the matrix by those of its upper triangle
_SECOND_NS = 10**9


@final
class VictoriaParkLog:
    """Lines `ODOMETRY from to x y theta` and `LANDMARK pose landmark x y`, each with a covariance, as steps.

    Poses and landmarks are numbered together. The covariances are the upper triangle, row by row, in m and rad; of a
    landmark in the robot's frame. The form has no time: the poses are stamped a second apart from 0 on.

    Parameters
    ----------
    path : str or Path
        Plain, .gz or .bz2.

    Raises
    ------
    InputError
        On reading, with the line: another tag, wrong columns, a covariance that is not positive definite, increments
        that do not follow each other, or a landmark seen from another pose than the last.
    """

    TAGS = frozenset(_COLUMNS)
    kind = ObservationKind.POSITION
    stamped = False
    truth: LandmarkTruth | None = None

    def __init__(self, path: str | Path) -> None:
        """Name the file."""
        self.path, self.statistics = Path(path), LandmarkLogStatistics()

    def __iter__(self) -> Iterator[LandmarkStep]:
        """Yield the steps in the order of the file, the first of them without motion."""
        self.statistics = LandmarkLogStatistics()
        pose, step = None, _Step(0, np.zeros(3), np.zeros((3, 3)))
        for line, tag, ids, values, covariance in self._rows():
            if pose is None:
                pose = ids[0]
            if ids[0] != pose:
                raise InputError(self.path, f"expected a line of pose {pose}, the last one, got {ids[0]}", line)
            if tag == _LANDMARK:
                if ids[1] in step.landmarks:
                    raise InputError(self.path, f"landmark {ids[1]} is seen twice from pose {pose}", line)
                step.add_observation(ids[1], values, covariance)
                continue
            yield self.statistics.count(step.build())
            self.statistics.odometry += 1
            pose, step = ids[1], _Step(step.stamp_ns + _SECOND_NS, values, covariance)
        if pose is None:
            raise InputError(self.path, f"expected lines {_ODOMETRY} and {_LANDMARK}, got none")
        yield self.statistics.count(step.build())

    def _rows(self) -> Iterator[tuple[int, str, list[int], FloatArray, FloatArray]]:
        """Number, tag, two ids, measurement (3,) or (2,) and covariance of each line."""
        sound: set[tuple[str, ...]] = set()  # covariances met before: most files have only one of each size
        for line, text in read_numbered_lines(self.path):
            tag, *words = text.split()
            columns = _COLUMNS.get(tag)
            if columns is None:
                raise InputError(self.path, f"expected {_ODOMETRY} or {_LANDMARK}, got {tag[:40]!r}", line)
            width = len(columns.split())
            if len(words) != width:
                raise InputError(self.path, f"{tag}: expected {width} numbers ({columns}), got {len(words)}", line)
            try:
                ids, values = [int(word) for word in words[:2]], np.array([float(word) for word in words[2:]])
            except ValueError:
                raise InputError(self.path, f"{tag}: expected numbers ({columns}), got {text!r:.200}", line) from None
            size = 3 if tag == _ODOMETRY else 2
            covariance = values[size:][_FULL[size]].reshape(size, size)
            told = tuple(words[2 + size :])
            if not np.isfinite(values).all() or (told not in sound and np.linalg.eigvalsh(covariance)[0] <= 0):
                problem = "expected finite numbers and a positive definite covariance"
                raise InputError(self.path, f"{tag}: {problem}, got {text!r:.200}", line)
            sound.add(told)
            yield line, tag, ids, values[:size], covariance


@final
class _Step:
    """A step in the making."""

    def __init__(self, stamp_ns: int, increment: FloatArray, covariance: FloatArray) -> None:
        self.stamp_ns, self.landmarks = stamp_ns, list[int]()
        self._increment, self._covariance = increment, covariance
        self._values, self._covariances = list[FloatArray](), list[FloatArray]()

    def add_observation(self, landmark: int, values: FloatArray, covariance: FloatArray) -> None:
        self.landmarks.append(landmark)
        self._values.append(values)
        self._covariances.append(covariance)

    def build(self) -> LandmarkStep:
        count = len(self.landmarks)
        covariances = np.array(self._covariances).reshape(count, 2, 2)
        observations = LandmarkObservations.of(np.array(self._values).reshape(count, 2), self.landmarks, covariances)
        return LandmarkStep(self.stamp_ns, self._increment, self._covariance, observations)
