"""Checks of exercise 10: grid-based FastSLAM."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from gridslam import OccupancyGrid, Trajectory
from gridslam.evaluation import absolute_errors
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate

FloatArray = NDArray[np.float64]
Rng = np.random.Generator


def effective_sample_size(n_eff: Callable[[FloatArray], float]) -> None:
    """`n_eff(log_weights)`: N of equal weights, 1 of a single one, and the same for weights of any scale."""
    cases = (
        np.zeros(8),
        np.log([0.5, 0.5, 1e-300, 1e-300]),
        np.log([1.0, 1e-300]),
        np.log([3.0, 1.0]),
        np.log([3.0, 1.0]) - 5000.0,
    )
    right = np.array([8.0, 2.0, 1.0, 1.6, 1.6])
    weights = [np.exp(case - case.max()) for case in cases]
    with np.errstate(all="ignore"):
        plain = [np.exp(case) for case in cases]
        found = [float(n_eff(case.copy())) for case in cases]
        wrong = {
            "normalize the weights first": [float(1 / np.square(w).sum()) for w in plain],
            "normalize the weights first ": [float(1 / np.square(w).sum()) for w in weights],
            "subtract the largest log weight before the exponential": [
                float(w.sum() ** 2 / np.square(w).sum()) for w in plain
            ],
            "the squares of the weights are summed, not the weights": [float(1 / (w / w.sum()).sum()) for w in weights],
            "it is 1 / sum(w^2), not sum(w^2)": [float(np.square(w / w.sum()).sum()) for w in weights],
            "it has no square root": [float(1 / math.sqrt(np.square(w / w.sum()).sum())) for w in weights],
            "it is not divided by the number of particles": [
                float(1 / np.square(w / w.sum()).sum() / len(w)) for w in weights
            ],
            "weights are exp of the log weights": [
                float(case.sum() ** 2 / np.square(case).sum()) if case.any() else math.nan for case in cases
            ],
        }
    expect("effective sample size of five sets of weights", found, right, 1e-9, wrong)


class Recorded:
    """A part of a filter that records in what order it is called, with which poses, and what it returns."""

    def __init__(self, name: str, part: Callable[..., object], calls: list[tuple[str, FloatArray, object]]) -> None:
        self._name, self._part, self._calls = name, part, calls

    def __getattr__(self, name: str) -> object:
        """Return what the part itself has by that name."""
        return getattr(self._part, name)

    def __call__(self, *given: object) -> object:
        """Call the part; a part that makes a function of a motion or a scan is recorded when that is called."""
        if self._name in ("predict", "weigh") and len(given) == 1:
            return Recorded(self._name, self._part(*given), self._calls)
        arrays = [value.copy() for value in given if isinstance(value, np.ndarray) and value.shape[1:] == (3,)]
        found = self._part(*given)
        self._calls.append((self._name, arrays[0], found))
        return found


NAMES = {"predict": "MOTION", "match": "MATCHER", "weigh": "SENSOR", "map": "MAPPER"}
CALLS: list[tuple[str, FloatArray, object]] = []
"""Calls of the parts that `recorded` has returned."""


def recorded(motion: object, matcher: object, sensor: object, mapper: object) -> list[Recorded]:
    """Return the parts such that `fastslam_step` sees in what order they are called."""
    parts = zip(NAMES, (motion, matcher, sensor, mapper), strict=True)
    return [Recorded(name, part, CALLS) for name, part in parts]  # type: ignore[arg-type]


GridStep = Callable[..., tuple[FloatArray, FloatArray]]


def fastslam_step(step: GridStep, mapper: OccupancyGridMapping) -> None:
    """`step(maps, poses, log_weights, increment, beams, rng)` with parts of `recorded`: order, poses and weights."""
    drive = poor_drive()
    first, second = (drive.measurements[k].scan.beams(0.05, 30.0) for k in (0, 4))
    maps, poses = mapper.empty(4), np.zeros((4, 3))
    mapper(maps, poses, first)
    CALLS.clear()
    before = np.array([0.0, -0.1, 0.05, -0.02])
    increment = between(*drive.odometry.poses[[0, 4]])
    found, log_weights = step(maps, poses, before.copy(), increment, second, np.random.default_rng(0))
    names = [name for name, _, _ in CALLS]
    for name in NAMES:
        require(name in names, f"step {name}: {NAMES[name]} is not called")
    at = {name: names.index(name) for name in NAMES}
    require(at["predict"] < at["match"], "predict before matching: the match begins at the predicted poses")
    require(at["match"] < at["weigh"], "match before weighing: weights are likelihoods at the matched poses")
    require(
        at["weigh"] < at["map"],
        "weigh before mapping: a scan that is in the map already fits it, wherever the particle is",
    )
    require(at["match"] < at["map"], "match before mapping: the scan is inserted at the matched poses")
    calls = {name: (given, result) for name, given, result in CALLS}
    predicted = np.asarray(calls["predict"][1])
    matched = np.asarray(calls["match"][1].poses)  # type: ignore[attr-defined]
    expect("poses that are matched", calls["match"][0], predicted, 0.0, {"match the predicted poses": poses})
    kept = {"use the matched poses from here on": predicted, "use the matched poses from here on ": poses}
    expect("poses that are weighed", calls["weigh"][0], matched, 0.0, kept)
    expect("poses at which the scan is mapped", calls["map"][0], matched, 0.0, kept)
    nats = np.asarray(calls["weigh"][1])
    wrong = {
        "the particles are resampled although N_eff is above N / 2": np.zeros(4),
        "weights are multiplied: add the log likelihoods to the log weights": nats,
        "weights are multiplied: the likelihoods of this scan are missing": before,
        "the log likelihoods are added, not subtracted": before - nats,
        "log weights are logarithms": np.exp(before + nats - (before + nats).max()),
    }
    expect("log weights", log_weights, before + nats, 1e-9, wrong)
    expect("poses after the step", found, matched, 0.0, kept)


def poor_drive() -> SimulatedLog:
    """Return the first 24 s (12 m) of a drive through an office with poor odometry; the truth starts at the origin.

    Aligned, the odometry alone strays from the truth by 0.68 m.
    """
    rng = np.random.default_rng(5)
    poor = OdometryNoise(distance_scale=1.03, turn_scale=0.93, bias_rad_per_m=0.01)
    whole = simulate(make_world("demo", rng), RobotConfig(), poor, LidarConfig(beams=120), rng)
    stamps = whole.truth.stamps_ns[:120]
    truth = Trajectory(stamps, between(whole.truth.poses[0], whole.truth.poses[:120]))
    odometry = Trajectory(stamps, whole.odometry.poses[:120])
    return SimulatedLog(whole.measurements[:120], truth, odometry, whole.walls)


def worst_error(poses: FloatArray, true_poses: FloatArray) -> float:
    """Largest distance (m) of a pose from the true one, the whole being aligned."""
    stamps = np.arange(len(poses)) * 10**9
    return absolute_errors(Trajectory(stamps, poses), Trajectory(stamps, true_poses)).trans_max_m


BAND_M = 0.1
"""Twice the worst error of the default filter on `poor_drive`, 0.05 m with 10 particles over 6 seeds."""


def poor_odometry_is_corrected(run: Callable[[Sequence[Measurement], Rng], FloatArray]) -> None:
    """`run(measurements, rng)` -> poses (T, 3) of all scans: two seeds of a drive through an office."""
    drive = poor_drive()
    for seed in range(2):
        worst = worst_error(run(drive.measurements, np.random.default_rng(seed)), drive.truth.poses)
        require(worst < BAND_M, f"seed {seed}: a pose is {worst:.2f} m from the truth")


FastSlamStep = Callable[[Measurement, FloatArray, FloatArray, Rng], tuple[FloatArray, FloatArray, list[OccupancyGrid]]]


def survivors_keep_their_maps(step: FastSlamStep) -> None:
    """`step(measurement, poses, log_weights, rng)` -> poses, log weights, maps: one of four particles has all weight.

    They are 40 m apart, have mapped the measurement, and get it again. All must end at the pose, and with the map, of
    the one that survives.
    """
    measurement = poor_drive().measurements[0]
    poses = np.array([[40.0 * k, 0.0, 0.0] for k in range(4)])
    log_weights = np.array([-1e3, -1e3, 0.0, -1e3])
    found, log_weights, maps = step(measurement, poses.copy(), log_weights, np.random.default_rng(0))
    unchanged = bool(np.abs(found - poses).max() < 0.05)
    require(not unchanged, "N_eff is 1, which is below N / 2: resample, poses and maps")
    near = np.abs(found - poses[2]).max() < 0.05
    require(bool(near), f"the survivor is particle 2: expected all poses near {poses[2]}, got {found.tolist()}")
    require(bool((log_weights == log_weights[0]).all()), "after resampling all log weights are equal: 0")
    for row, grid in enumerate(maps):
        x, _ = grid.origin
        require(
            40 < x < 80, f"`maps.select(parents)` copies the maps: the map of particle {row} is that of another one"
        )
