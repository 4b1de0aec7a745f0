"""Logs of landmarks, UTIAS MRCLAM and Victoria Park, as steps of motion and observations."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import Protocol, final, runtime_checkable

import numpy as np

from gridslam.arguments import describe, is_covariance
from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.angles import wrap_headings
from gridslam.geometry.se2 import compose, exp
from gridslam.io.measurement import FARTHEST_M
from gridslam.io.tables import Row, parse_tagged, read_rows, read_table, symmetric_of_upper
from gridslam.io.text import read_head, read_numbered_lines
from gridslam.models.landmark import NO_OBSERVATIONS, LandmarkObservations, LandmarkStep, ObservationKind
from gridslam.types import FloatArray, IntArray, Trajectory

_HEAD_BYTES = 4096
_KNOWN = "an odometry file of UTIAS MRCLAM (.._Odometry.dat) or lines ODOMETRY and LANDMARK (Victoria Park)"
_MRCLAM_NAME = re.compile(r"(?P<set>.*?)(?P<robot>Robot\d+_)(Odometry|Measurement)\.dat(\.gz|\.bz2)?$")
_MEASUREMENT = "time_s barcode range_m bearing_rad"
_STANDING = np.zeros(3)
_PARK_COLUMNS = {
    "ODOMETRY": ("from to", "x_m y_m theta_rad xx xy xt yy yt tt"),
    "LANDMARK": ("pose landmark", "x_m y_m xx xy yy"),
}
_SECOND_NS = 10**9
_FARTHEST_SEEN_M = 1e5  # no sensor of a robot sees farther: such a number is a damaged one
_LEAST_VARIANCE = 1e-12
_MOST_VARIANCE = 1e12
"""m^2 and rad^2: of standard deviations from a micrometre to a thousand kilometres."""


@final
@dataclass(slots=True)
class LandmarkLogStatistics:
    """Statistics of a log that is being read.

    Attributes
    ----------
    odometry : int
        Readings of the odometry.
    steps : int
        Steps given.
    observations : int
        Number of landmark observations.
    robots : int
        Observations of other robots, which are no landmarks; left out.
    unknown : int
        Observations with an unknown barcode (misread); left out.
    first_ns, last_ns : int
        Stamps of the first and the last step.
    """

    odometry: int = 0
    steps: int = 0
    observations: int = 0
    robots: int = 0
    unknown: int = 0
    first_ns: int = 0
    last_ns: int = 0

    @property
    def duration_s(self) -> float:
        """From the first step to the last, s."""
        return 1e-9 * (self.last_ns - self.first_ns)

    def count(self, step: LandmarkStep) -> LandmarkStep:
        """Count a step, and give it back."""
        if not self.steps:
            self.first_ns = step.stamp_ns
        self.last_ns = step.stamp_ns
        self.steps += 1
        self.observations += len(step.observations)
        return step


@final
@dataclass(frozen=True, slots=True, eq=False)
class LandmarkTruth:
    """The truth about a log, in a frame of its own.

    Attributes
    ----------
    trajectory : Trajectory or None
        Of the robot.
    landmarks : (M,) int64
        Signatures of the landmarks.
    positions : (M, 2) float64, m
        Where they are.
    """

    trajectory: Trajectory | None
    landmarks: IntArray
    positions: FloatArray


@runtime_checkable
class LandmarkLog(Protocol):
    """A log of landmarks; each iteration rereads it incrementally."""

    path: Path
    kind: ObservationKind
    stamped: bool
    """Whether its stamps are times; else they only count the steps, a second each."""
    statistics: LandmarkLogStatistics
    truth: LandmarkTruth | None

    def __iter__(self) -> Iterator[LandmarkStep]:
        """Yield the steps in the order of time; raises InputError with the line where the log cannot be used."""
        ...


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

    Raises
    ------
    InputError
        A file is not there or cannot be used; with the line where one is wrong.

    References
    ----------
    K. Leung et al., The UTIAS multi-robot cooperative localization and mapping dataset, IJRR 2011.
    """

    kind = ObservationKind.DEPTH_BEARING
    stamped = True

    def __init__(
        self,
        path: str | Path,
        longest_ns: int = 250_000_000,
        delay_ns: int = 200_000_000,
    ) -> None:
        """Find the files and read the small ones."""
        self.path = Path(path)
        self.statistics = LandmarkLogStatistics()
        self._longest_ns = longest_ns
        self._delay_ns = delay_ns
        names = _MRCLAM_NAME.match(self.path.name)
        if names is None:
            raise InputError(path, "expected a file named ..RobotN_Odometry.dat or ..RobotN_Measurement.dat")
        robot = names["set"] + names["robot"]
        self._odometry = self._beside(f"{robot}Odometry")
        self._measurement = self._beside(f"{robot}Measurement")
        self._subject_of = _read_barcodes(self._beside(f"{names['set']}Barcodes"))
        landmarks = read_table(
            self._beside(f"{names['set']}Landmark_Groundtruth"), "subject x_m y_m std_x_m std_y_m"
        ).values
        truth = self._find(f"{robot}Groundtruth")
        trajectory = None if truth is None else _read_trajectory(truth)
        self.truth: LandmarkTruth | None = LandmarkTruth(
            trajectory, landmarks[:, 0].astype(np.int64), landmarks[:, 1:3]
        )
        self._landmarks = frozenset(self.truth.landmarks.tolist())

    def __iter__(self) -> Iterator[LandmarkStep]:
        """Yield the steps in the order of time; raises InputError with the line where the log cannot be used."""
        self.statistics = LandmarkLogStatistics()
        command = 0.0, 0.0
        increment = _STANDING
        now = begun = None
        events: Iterator[tuple[int, LandmarkObservations | tuple[float, float]]]
        events = heapq.merge(self._commands(), self._read_observations(), key=lambda event: event[0])
        for stamp, event in events:
            if now is None or begun is None:
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
                increment = _STANDING
                begun = stamp

    def _commands(self) -> Iterator[tuple[int, tuple[float, float]]]:
        for row in read_rows(self._odometry, "time_s v_m_s omega_rad_s", stamps=1, in_order=True):
            if not max(map(abs, row.values)) <= FARTHEST_M:
                raise InputError(self._odometry, f"expected speeds up to {FARTHEST_M:g}, got {row.values}", row.line)
            self.statistics.odometry += 1
            yield row.stamps_ns[0] + self._delay_ns, (row.values[0], row.values[1])

    def _read_observations(self) -> Iterator[tuple[int, LandmarkObservations]]:
        """Yield landmarks seen, all of one stamp together; stamps at which there is none are left out."""
        rows = read_rows(self._measurement, _MEASUREMENT, stamps=1, in_order=True)
        for (stamp,), group in groupby(rows, key=lambda row: row.stamps_ns):
            seen: dict[int, tuple[float, float]] = {}
            for row in group:
                subject = self._subject(row)
                if subject in seen:
                    raise InputError(self._measurement, f"subject {subject} is seen twice at one time", row.line)
                if subject is not None:
                    seen[subject] = row.values[1], row.values[2]
            if seen:
                yield stamp, LandmarkObservations.of(list(seen.values()), list(seen))

    def _subject(self, row: Row) -> int | None:
        """Return the landmark that a row is of; None where it is of a robot, or misread."""
        barcode, distance, bearing = row.values
        if not (barcode.is_integer() and 0 < distance <= _FARTHEST_SEEN_M and abs(bearing) <= np.pi):
            expected = f"a whole barcode, a range above 0 and up to {_FARTHEST_SEEN_M:g} and a bearing within pi"
            problem = f"expected {_MEASUREMENT} with {expected}"
            raise InputError(self._measurement, f"{problem}, got {barcode:g} {distance:g} {bearing:g}", row.line)
        subject = self._subject_of.get(int(barcode))
        if subject is None:
            self.statistics.unknown += 1
        elif subject not in self._landmarks:
            self.statistics.robots += 1
            return None
        return subject

    def _find(self, stem: str) -> Path | None:
        paths = (self.path.with_name(f"{stem}.dat{suffix}") for suffix in ("", ".gz", ".bz2"))
        return next((path for path in paths if path.exists()), None)

    def _beside(self, stem: str) -> Path:
        if (found := self._find(stem)) is None:
            raise InputError(self.path, f"expected {stem}.dat (or .gz, .bz2) beside it, got none")
        return found


def _read_barcodes(path: Path) -> dict[int, int]:
    """Subjects of MRCLAM by their barcodes."""
    pairs = read_table(path, "subject barcode").values
    subjects, barcodes = pairs.astype(np.int64).T.tolist()
    if not (pairs == np.rint(pairs)).all() or len(set(barcodes)) < len(barcodes):
        raise InputError(path, "expected whole numbers, each barcode once")
    return dict(zip(barcodes, subjects, strict=True))


def _read_trajectory(path: Path) -> Trajectory:
    """Return the truth about a robot of MRCLAM."""
    table = read_table(path, "time_s x_m y_m theta_rad", stamps=1, in_order=True)
    return Trajectory(table.stamps_ns[:, 0], wrap_headings(table.values))


@final
class VictoriaParkLog:
    """Landmark logs in the form of GTSAM's Victoria Park file, as steps: increments and positions of landmarks.

    Lines are `ODOMETRY from to x y theta` and `LANDMARK pose landmark x y`, each with a covariance. Poses and landmarks
    are numbered together. The covariances are the upper triangle, row by row, in m and rad; of a landmark in the
    robot's frame. The form has no time: the poses are stamped a second apart from 0 on.

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

    kind = ObservationKind.POSITION
    stamped = False
    truth: LandmarkTruth | None = None

    def __init__(self, path: str | Path) -> None:
        """Name the file."""
        self.path = Path(path)
        self.statistics = LandmarkLogStatistics()

    def __iter__(self) -> Iterator[LandmarkStep]:
        """Yield the steps in the order of the file, the first of them without motion."""
        self.statistics = LandmarkLogStatistics()
        pose = None
        motion = np.zeros(3), np.zeros((3, 3))
        seen: dict[int, tuple[FloatArray, FloatArray]] = {}
        for line, tag, ids, measured in self._rows():
            pose = ids[0] if pose is None else pose
            if ids[0] != pose:
                raise InputError(self.path, f"expected a line of pose {pose}, the last one, got {ids[0]}", line)
            if tag == "ODOMETRY":
                yield self._step(motion, seen)
                self.statistics.odometry += 1
                pose = ids[1]
                motion = measured
                seen = {}
            elif ids[1] in seen:
                raise InputError(self.path, f"landmark {ids[1]} is seen twice from pose {pose}", line)
            else:
                seen[ids[1]] = measured
        if pose is None:
            raise InputError(self.path, "expected lines ODOMETRY and LANDMARK, got none")
        yield self._step(motion, seen)

    def _step(
        self, motion: tuple[FloatArray, FloatArray], seen: dict[int, tuple[FloatArray, FloatArray]]
    ) -> LandmarkStep:
        """Return the step of an increment, and of the landmarks seen after it, each with its covariance."""
        values = np.array([value for value, _ in seen.values()]).reshape(-1, 2)
        covariances = np.array([covariance for _, covariance in seen.values()]).reshape(-1, 2, 2)
        observations = LandmarkObservations.of(values, list(seen), covariances)
        return self.statistics.count(LandmarkStep(self.statistics.steps * _SECOND_NS, *motion, observations))

    def _rows(self) -> Iterator[tuple[int, str, list[int], tuple[FloatArray, FloatArray]]]:
        """Yield number, tag, two ids, and measurement (3,) or (2,) with covariance of each line."""
        for line, text in read_numbered_lines(self.path):
            tag = text.split(None, 1)[0]
            if tag not in _PARK_COLUMNS:
                raise InputError(self.path, f"expected ODOMETRY or LANDMARK, got {tag[:40]!r}", line)
            ids, numbers = parse_tagged(self.path, line, text, *_PARK_COLUMNS[tag])
            size = 3 if tag == "ODOMETRY" else 2
            values = np.array(numbers[:size])
            covariance = _positive_definite(tuple(numbers[size:]))
            farthest_m = FARTHEST_M if tag == "ODOMETRY" else _FARTHEST_SEEN_M
            if not (np.abs(values) <= farthest_m).all():
                problem = f"{tag}: expected numbers up to {farthest_m:g} m and rad, got {text!r:.200}"
                raise InputError(self.path, problem, line)
            if covariance is None:
                expected = f"positive definite covariance with variances from {_LEAST_VARIANCE:g} to {_MOST_VARIANCE:g}"
                raise InputError(self.path, f"{tag}: expected a {expected}, got {text!r:.200}", line)
            yield line, tag, ids, (values, covariance)


@lru_cache(maxsize=16)  # most files have one covariance of each size
def _positive_definite(upper: tuple[float, ...]) -> FloatArray | None:
    """Matrix of an upper triangle; None where it is no covariance of anything that can be measured."""
    matrix = symmetric_of_upper(np.array(upper))
    matrix.flags.writeable = False
    variances = np.diagonal(matrix)
    plausible = ((variances >= _LEAST_VARIANCE) & (variances <= _MOST_VARIANCE)).all()
    return matrix if plausible and is_covariance(matrix) else None


def open_landmark_log(path: str | Path) -> LandmarkLog:
    """Open a log of landmarks (plain, .gz or .bz2); the format is detected from name and content.

    Raises
    ------
    InputError
        There is no such file, it is of another form, or a file that belongs to it is not beside it.
    """
    where = Path(path)
    if where.is_dir():
        raise InputError(path, f"expected {_KNOWN}, got a folder")
    lines = read_head(where, _HEAD_BYTES).decode("latin-1").splitlines()
    first = next((line.split()[0] for line in lines if line.split() and not line.startswith("#")), "")
    if _MRCLAM_NAME.match(where.name):
        return MrclamLog(where)
    if first in _PARK_COLUMNS:
        return VictoriaParkLog(where)
    raise InputError(path, f"expected {_KNOWN}, got a line that begins with {first[:40]!r}")


def open_landmark_log_if_path(log: str | Path | LandmarkLog) -> LandmarkLog:
    """Open the log at a path, or return an open one; raises ArgumentError for other values."""
    if isinstance(log, str | Path):
        return open_landmark_log(log)
    if not isinstance(log, LandmarkLog):
        raise ArgumentError("log", "str, Path or a log as open_landmark_log gives it", describe(log))
    return log
