"""UTIAS MRCLAM logs: a robot's velocity commands, ranges and bearings to barcodes, and the truth."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import final

import numpy as np

from gridslam.errors import InputError
from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import compose, exp
from gridslam.io.landmarks.log import LandmarkLogStatistics, LandmarkTruth
from gridslam.io.number_rows import NumberRow, read_numbered_lines, read_stamped_rows
from gridslam.models.landmark import NO_OBSERVATIONS, LandmarkObservations, LandmarkStep, ObservationKind
from gridslam.types import FloatArray, Trajectory

__all__ = ["MrclamLog"]

_NAME = re.compile(r"(?P<set>.*?)(?P<robot>Robot\d+_)(Odometry|Measurement)\.dat(\.gz|\.bz2)?$")
_ODOMETRY = "time_s v_m_s omega_rad_s"
_MEASUREMENT = "time_s barcode range_m bearing_rad"
_TRUTH = "time_s x_m y_m theta_rad"
_BARCODES = "subject barcode"
_LANDMARKS = "subject x_m y_m std_x_m std_y_m"
_STANDING = np.zeros(3)


@final
class MrclamLog:
    """One robot of a dataset of UTIAS MRCLAM, as steps.

    A command (v, omega) holds until the next one; arcs between two steps are composed to one increment. A step ends
    where landmarks are seen, all those of one stamp together, and at the latest after `longest_ns`. Subjects that
    `..Landmark_Groundtruth.dat` does not name are other robots: not landmarks, for they move. What the files call range
    is the depth along the camera's axis: see `gridslam.models.landmark.DepthBearing`.

    Parameters
    ----------
    path : str or Path
        `[SET]RobotN_Odometry.dat` (or its `_Measurement.dat`), plain or compressed. Beside it must be the other of the
        two, `[SET]Barcodes.dat` and `[SET]Landmark_Groundtruth.dat`; `[SET]RobotN_Groundtruth.dat` may be there.
    longest_ns : int, > 0
        Longest step without an observation, if the odometry is as dense.
    delay_ns : int
        Latency of a command relative to its stamp. The files contain commands, and wheels take
        time; 0.2 s fits the observations of the robots best.
    depth_scale : float, > 0
        By which factor the cameras take depths for greater than they are: 1.03 for both robots of set 6. It cannot be
        found without the truth, for it scales the map, and makes 0.09 m of error in a room of 8 m.

    Raises
    ------
    InputError
        A file is not there or cannot be used; with the line where one is wrong.

    Source: K. Leung et al., The UTIAS multi-robot cooperative localization and mapping dataset, IJRR 2011.
    """

    kind = ObservationKind.DEPTH_BEARING
    stamped = True

    def __init__(
        self, path: str | Path, longest_ns: int = 250_000_000, delay_ns: int = 200_000_000,
        depth_scale: float = 1.03,
    ) -> None:  # fmt: skip
        """Find the files and read the small ones."""
        self.path, self.statistics, self._longest_ns = Path(path), LandmarkLogStatistics(), longest_ns
        self._delay_ns, self._depth_scale = delay_ns, depth_scale
        names = _NAME.match(self.path.name)
        if names is None:
            raise InputError(path, "expected a file named ..RobotN_Odometry.dat or ..RobotN_Measurement.dat")
        self._of_set, self._of_robot = names["set"], names["set"] + names["robot"]
        self._odometry, self._measurement = (self._beside(f"{self._of_robot}{n}") for n in ("Odometry", "Measurement"))
        self._subject_of = self._read_barcodes()
        self.truth: LandmarkTruth | None = self._read_truth()

    @staticmethod
    def names(path: Path) -> bool:
        """Whether a file is named as one of these logs."""
        return _NAME.match(path.name) is not None

    def __iter__(self) -> Iterator[LandmarkStep]:
        """Yield the steps in the order of time; raises InputError with the line where the log cannot be used."""
        self.statistics = LandmarkLogStatistics()
        command, increment, now, begun = (0.0, 0.0), _STANDING, None, 0
        events: Iterator[tuple[int, LandmarkObservations | tuple[float, float]]]
        events = heapq.merge(self._commands(), self._read_observations(), key=lambda event: event[0])
        for stamp, event in events:
            if now is None:
                now = begun = stamp
            seen = event if isinstance(event, LandmarkObservations) else NO_OBSERVATIONS
            ends = seen is event or stamp - begun >= self._longest_ns
            if ends or event != command:  # an arc ends
                passed = 1e-9 * (stamp - now)
                increment = compose(increment, exp(np.array([command[0] * passed, 0.0, command[1] * passed])))
                now = stamp
            if not isinstance(event, LandmarkObservations):
                command = event
            if ends:
                yield self.statistics.count(LandmarkStep(stamp, increment, None, seen))
                increment, begun = _STANDING, stamp

    def _commands(self) -> Iterator[tuple[int, tuple[float, float]]]:
        for row in read_stamped_rows(self._odometry, _ODOMETRY):
            self.statistics.odometry += 1
            yield row.stamp_ns + self._delay_ns, (row.values[0], row.values[1])

    def _read_observations(self) -> Iterator[tuple[int, LandmarkObservations]]:
        """Landmarks seen, all of one stamp together; stamps at which there is none are left out."""
        for stamp, rows in groupby(read_stamped_rows(self._measurement, _MEASUREMENT), key=lambda row: row.stamp_ns):
            values, subjects = list[list[float]](), list[int]()
            for row in rows:
                subject = self._subject(row)
                if subject is None:
                    continue
                if subject in subjects:
                    raise InputError(self._measurement, f"subject {subject} is seen twice at one time", row.line)
                subjects.append(subject)
                values.append([row.values[1] / self._depth_scale, row.values[2]])
            if subjects:
                yield stamp, LandmarkObservations.of(values, subjects)

    def _subject(self, row: NumberRow) -> int | None:
        """Return the landmark that a row is of; None where it is of a robot, or misread."""
        barcode, distance, bearing = row.values
        if not (barcode.is_integer() and distance > 0 and abs(bearing) <= np.pi):
            problem = f"expected {_MEASUREMENT} with a whole barcode, a range above 0 and a bearing within pi"
            raise InputError(self._measurement, f"{problem}, got {barcode:g} {distance:g} {bearing:g}", row.line)
        subject = self._subject_of.get(int(barcode))
        if subject is None:
            self.statistics.unknown += 1
        elif subject not in self._landmarks:
            self.statistics.robots += 1
            return None
        return subject

    def _read_barcodes(self) -> dict[int, int]:
        path = self._beside(f"{self._of_set}Barcodes")
        pairs = _table(path, _BARCODES)
        subjects, barcodes = pairs.astype(np.int64).T.tolist()
        if not (pairs == pairs.astype(np.int64)).all() or len(set(barcodes)) < len(barcodes):
            raise InputError(path, "expected whole numbers, each barcode once")
        return dict(zip(barcodes, subjects, strict=True))

    def _read_truth(self) -> LandmarkTruth:
        rows = _table(self._beside(f"{self._of_set}Landmark_Groundtruth"), _LANDMARKS)
        self._landmarks = frozenset(rows[:, 0].astype(int).tolist())
        trajectory = None
        if (path := self._find(f"{self._of_robot}Groundtruth")) is not None:
            told = list(read_stamped_rows(path, _TRUTH))
            poses = np.array([row.values for row in told]).reshape(-1, 3)
            poses[:, 2] = wrap(poses[:, 2])
            trajectory = Trajectory(np.array([row.stamp_ns for row in told], np.int64), poses)
        return LandmarkTruth(trajectory, rows[:, 0].astype(np.int64), rows[:, 1:3])

    def _find(self, stem: str) -> Path | None:
        paths = (self.path.with_name(f"{stem}.dat{suffix}") for suffix in ("", ".gz", ".bz2"))
        return next((path for path in paths if path.exists()), None)

    def _beside(self, stem: str) -> Path:
        if (found := self._find(stem)) is None:
            raise InputError(self.path, f"expected {stem}.dat (or .gz, .bz2) beside it, got none")
        return found


def _table(path: Path, columns: str) -> FloatArray:
    """Rows of a small table of numbers (N, columns); raises InputError with the line."""
    width, rows = len(columns.split()), list[list[float]]()
    for number, line in read_numbered_lines(path):
        try:
            rows.append([float(word) for word in line.split()])
        except ValueError:
            raise InputError(path, f"expected numbers ({columns}), got {line!r:.200}", number) from None
        if len(rows[-1]) != width or not np.isfinite(rows[-1]).all():
            raise InputError(path, f"expected {width} finite numbers ({columns}), got {line!r:.200}", number)
    if not rows:
        raise InputError(path, f"expected rows of {columns}, got none")
    return np.array(rows)
