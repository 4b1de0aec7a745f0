"""Real logs made harder: worse odometry, fewer scans, an odometry that begins anew; the truth is that of the clean run.

For the sparse logs, of which there is no clean one, it is the reference that comes with them. Beside them stands the
simulated campus, 2 km with a scan every metre, whose truth is known.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "tests"))  # where support is
from closure_worlds import campus
from gridslam import CarmenLog
from gridslam.geometry.se2 import between, compose, exp, log
from gridslam.io.measurement import Measurement
from gridslam.types import FloatArray, IntArray, Odometry
from support.faults import odometry_drift, odometry_scale, wheel_slip

__all__ = ["LOGS", "PARTS", "SPARSE", "Variant", "measurements_of", "sparse_campus", "variant", "variants"]

LOGS: Final = {"intel": "intel.clf.bz2", "aces": "aces.clf.bz2", "csail": "mit-csail.clf.bz2"}
SPARSE: Final = ("acapulco", "belgioioso", "freiburg-101", "seattle")
PARTS: Final = {
    "b": "Worse odometry",
    "c": "Thinned logs",
    "d": "Sparse logs",
    "e": "Two halves, the second with other odometry",
}
_THINNED = (2, 5, 10, 16)
_KEY_M, _KEY_RAD = 0.5, 0.5
_CAMPUS = "a scan every metre"
_CAMPUS_M, _CAMPUS_RAD = 1.0, 0.5
_CAMPUS_SCALE, _CAMPUS_RAD_PER_M, _CAMPUS_RAD_PER_SQRT_M = 1.02, 0.004, 0.02
_DRIFT_RAD_PER_M, _SCALE, _SLIP_M = 0.05, 0.1, 0.5


class Variant(NamedTuple):
    """A log made harder.

    Attributes
    ----------
    measurements : list of Measurement, length N
    truth : (N, 3) float64
        Poses that a good map gives them.
    """

    measurements: list[Measurement]
    truth: FloatArray


def variants(part: str, data: Path) -> list[tuple[str, str]]:
    """Names of the logs of one part that are there, and what each is made into."""
    if part == "d":
        there = [(name, "as it is") for name in SPARSE if (data / "sparse" / f"{name}.clf.gz").is_file()]
        return [*there, ("campus", _CAMPUS)]
    kinds = {"b": list(_WORSE), "c": [*(f"every {n}" for n in _THINNED), "0.5 m or 0.5 rad"], "e": ["two halves"]}
    return [(name, kind) for name, file in LOGS.items() if (data / file).is_file() for kind in kinds[part]]


def variant(
    name: str, kind: str, data: Path, seed: int, clean: Callable[[str, list[Measurement]], FloatArray]
) -> Variant:
    """Make one of `variants`; `clean` gives the poses (N, 3) of the clean run of a log by name."""
    if name == "campus":
        return sparse_campus(seed)
    if name in SPARSE:
        stem = data / "sparse" / name
        rows = np.loadtxt(stem.with_name(f"{name}.ref.tum.gz"))
        poses = np.column_stack([rows[:, 1:3], 2 * np.arctan2(rows[:, 6], rows[:, 7])])
        return Variant(list(CarmenLog(stem.with_name(f"{name}.clf.gz"))), poses)
    scans = measurements_of(name, data)
    truth, rng = clean(name, scans), np.random.default_rng([seed, 4])
    if kind in _WORSE:
        return Variant(_WORSE[kind](scans, rng), truth)
    if kind == "two halves":
        return Variant(_begun_anew(scans, rng), truth)
    kept = _moved(scans) if kind.endswith("rad") else np.arange(0, len(scans), int(kind.removeprefix("every ")))
    return Variant([scans[k] for k in kept.tolist()], truth[kept])


def sparse_campus(seed: int) -> Variant:
    """Simulate the campus with a scan every metre or half radian, and odometry that turns to one side."""
    stream, rng = campus(seed).stream(), np.random.default_rng(seed)
    scans, truth = [scan for _, scan in stream.measurements], np.asarray(stream.truth.poses)
    odometry = np.asarray(stream.odometry.poses)
    twists = log(between(odometry[:-1], odometry[1:]))
    moved = np.hypot(twists[:, 0], twists[:, 1])
    twists[:, 2] += _CAMPUS_RAD_PER_M * moved + _CAMPUS_RAD_PER_SQRT_M * rng.standard_normal(len(moved)) * np.sqrt(
        moved
    )
    twists[:, :2] *= _CAMPUS_SCALE
    wrong = [odometry[0]]
    for step in exp(twists):
        wrong.append(compose(wrong[-1], step))
    told = [Odometry.at(scan.stamp_ns, pose) for scan, pose in zip(scans, wrong, strict=True)]
    kept = _moved(list(map(Measurement, told, scans)), _CAMPUS_M, _CAMPUS_RAD)
    return Variant([Measurement(told[k], scans[k]) for k in kept.tolist()], truth[kept])


def measurements_of(name: str, data: Path) -> list[Measurement]:
    """All of a log."""
    return list(CarmenLog(data / LOGS[name]))


def _moved(scans: list[Measurement], metres: float = _KEY_M, radians: float = _KEY_RAD) -> IntArray:
    """Scans at which odometry has moved far enough since the last one of them."""
    kept, last = [0], scans[0].odometry
    for k, (odometry, _) in enumerate(scans):
        assert odometry is not None
        assert last is not None
        x, y, turn = between(last.pose, odometry.pose)
        if math.hypot(x, y) >= metres or abs(turn) >= radians:
            kept.append(k)
            last = odometry
    return np.array(kept)


def _begun_anew(scans: list[Measurement], rng: np.random.Generator) -> list[Measurement]:
    """Let odometry begin anew in the middle of a log, somewhere else, and turned."""
    half = len(scans) // 2
    begin, first = rng.uniform((-10, -10, -math.pi), (10, 10, math.pi)), scans[half].odometry
    assert first is not None
    second = [
        Measurement(Odometry.at(odometry.stamp_ns, compose(begin, between(first.pose, odometry.pose))), scan)
        for odometry, scan in scans[half:]
        if odometry is not None
    ]
    return scans[:half] + second


_WORSE: Mapping[str, Callable[[list[Measurement], np.random.Generator], list[Measurement]]] = MappingProxyType(
    {
        f"drift {_DRIFT_RAD_PER_M} rad/m": lambda scans, rng: list(odometry_drift(scans, _DRIFT_RAD_PER_M)),
        f"slip {_SLIP_M} m": lambda scans, rng: list(wheel_slip(scans, _SLIP_M, rng)),
        f"scale {1 + _SCALE:g}": lambda scans, rng: list(odometry_scale(scans, _SCALE)),
        "no odometry": lambda scans, rng: [Measurement(None, scan) for _, scan in scans],
    }
)
