"""Calls of the public functions, classes and methods with arguments that they do not expect.

Each call has healthy arguments where an example of them is known, but for one or two. It passes where a value comes
back or gridslam's own error, and TypeError where arguments are missing; memory and time are bounded as for files.
"""

from __future__ import annotations

import importlib
import inspect
import json
import os
import resource
import types
from collections.abc import Callable, Iterator
from dataclasses import replace
from enum import Enum
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import gridslam
from gridslam.config import Configuration, override
from gridslam.errors import GridslamError, InputError
from gridslam.grid import Evidence
from gridslam.grid.scan_batch import NOT_WEIGHED, ScanBatch
from gridslam.io.csv import write_csv_log
from gridslam.localization import KnownMap, MonteCarloLocalization
from gridslam.matching import GaussNewton, Pyramid
from gridslam.models import CauchyEndPoint, GaussianIncrement, LikelihoodField
from gridslam.particles import Ancestry
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam import Tracker
from gridslam.transforms import TransformBuffer

__all__ = ["PACKAGES", "PublicCall", "api", "public_calls"]

PACKAGES = (
    *("gridslam", "gridslam.config", "gridslam.doctor", "gridslam.evaluation", "gridslam.geometry.angles"),
    *("gridslam.geometry.rigid", "gridslam.geometry.se2", "gridslam.geometry.se3", "gridslam.grid"),
    *("gridslam.localization", "gridslam.mapping", "gridslam.matching", "gridslam.models", "gridslam.particles"),
    *("gridslam.sim", "gridslam.slam", "gridslam.transforms", "gridslam.types"),
)
_OF_FILTERS = ("GridFastSlamState", "MonteCarloState", "TrackerState", "ReportBuilder", "require_step")
"""What filters alone call, for each scan: they hand in what they have checked."""
_SETTINGS = (10, 2.0, 2.0, 0.1, 0.02, 2e-4, 3.5, 0.01, True)
"""Of a matcher."""
_MEMORY_BYTES = 1 << 30
_ODD: tuple[Any, ...] = (
    *(None, True, "x", "", b"x", [], {}, (), [[]], object(), -1, 0, 10**18, 10**30, -(2**31), 2**63, 0.5, 1e300),
    *(-1e300, np.nan, np.inf, 1j, "nan", [1, [2]], {"a": 1}, {1}, range(3), lambda: None, np.float64, Path("x")),
    *(np.int32(2), np.float32(1.5), np.datetime64("2020"), np.str_("x"), [None], ["x", 2.0], (0.0, 0.0, 0.0)),
)
_SHAPES = (
    (),
    (0,),
    (1,),
    (3,),
    (7,),
    (0, 0),
    (0, 3),
    (1, 3),
    (2, 3),
    (3, 1),
    (4, 2),
    (3, 3),
    (7, 7),
    (2, 0),
    (1, 2, 3),
    (2, 3, 3),
)
_LARGE = ((10**5, 1), (10**7, 0), (10**5, 3), (0, 10**7))
_TYPES = (
    np.float64,
    np.float32,
    np.int64,
    np.int32,
    np.uint8,
    np.bool_,
    np.complex128,
    np.object_,
    np.str_,
    "datetime64[ns]",
    ">f8",
)


class PublicCall(NamedTuple):
    """A public function or class, or a public method, by its name, what gives its owner, and how it is called."""

    name: str
    owner: str
    function: Callable[..., Any]


@cache
def public_calls() -> tuple[PublicCall, ...]:
    """All that the public packages name: functions, classes and their methods; none twice."""
    calls: dict[int, PublicCall] = {}
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in module.__all__:
            thing = getattr(module, name)
            whole = f"{package.removeprefix('gridslam.')}.{name}"
            is_class = isinstance(thing, type)
            if not (is_class or inspect.isfunction(thing)) or name in _OF_FILTERS or (is_class and _is_plain(thing)):
                continue
            calls.setdefault(id(thing), PublicCall(whole, "", thing))
            for method, function in vars(thing).items() if inspect.isclass(thing) else ():
                if method.startswith("_") and method != "__call__":
                    continue
                if isinstance(function, classmethod | staticmethod):
                    calls.setdefault(id(function), PublicCall(f"{whole}.{method}", "", getattr(thing, method)))
                elif inspect.isfunction(function):
                    calls.setdefault(id(function), PublicCall(f"{whole}.{method}", name, function))
    return tuple(sorted(calls.values(), key=lambda call: call.name))


def _is_plain(kind: type) -> bool:
    """Whether a class is not made by callers: errors, enumerators, Protocols."""
    return issubclass(kind, Exception | Enum) or getattr(kind, "_is_protocol", False)


def api(folder: Path) -> Iterator[tuple[str, int, Any, Callable[[Path], object], float]]:
    """Name, point, the two functions and the weight of the one family."""
    examples = make_examples(folder)
    calls = public_calls()

    def prepare(to: Path, rng: np.random.Generator) -> None:
        case = {"call": int(rng.integers(len(calls))), "seed": int(rng.integers(2**31))}
        (to / "case.json").write_text(json.dumps(case))

    def read(where: Path) -> None:
        case = json.loads((where / "case.json").read_text())
        os.chdir(where)
        try_call(calls[case["call"]], examples, np.random.default_rng(case["seed"]))

    yield "public API", 7, prepare, read, 6.0


def try_call(call: PublicCall, examples: Examples, rng: np.random.Generator) -> None:
    """Make one call; raises InputError where it is refused, and whatever else comes."""
    arguments, options, what = choose_arguments(call, examples, rng)
    text = f"{call.name}({', '.join(what)})"
    owner = [_find_owner(call, examples)] if call.owner else []
    if owner == [None]:
        raise InputError(Path.cwd(), f"{call.name}: no object is known")
    with np.errstate(all="ignore"):
        try:
            result = call.function(*owner, *arguments, **options)
            if isinstance(result, types.GeneratorType):
                list(islice(result, 3))
        except GridslamError as error:
            raise InputError(Path.cwd(), f"{text}: {error}".replace("\n", " ")) from None
        except ValueError as error:
            if type(error).__module__.startswith("pydantic"):
                raise InputError(Path.cwd(), f"{text}: refused") from None
            raise RuntimeError(f"{text} {type(error).__name__}: {error}") from error
        except SystemExit:
            raise
        except BaseException as error:
            raise RuntimeError(f"{text} {type(error).__name__}: {error}") from error
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert used * 1024 < _MEMORY_BYTES, f"{text}: {used >> 10} MB"


def _find_owner(call: PublicCall, examples: Examples) -> Any:
    """An object of the method's class: an example, or one with all defaults, or None."""
    kind = next(each.function for each in public_calls() if each.name == call.name.rpartition(".")[0])
    if isinstance(kind, type) and kind in examples.by_type:
        return examples.by_type[kind]
    try:
        return kind()
    except Exception:
        return None


def choose_arguments(
    call: PublicCall, examples: Examples, rng: np.random.Generator
) -> tuple[list[Any], dict[str, Any], list[str]]:
    """Positional and named arguments of a call, one or two of them odd, and each as text."""
    parameters = list(_signature(call).parameters.values())
    if call.owner:
        parameters = parameters[1:]
    parameters = [each for each in parameters if each.kind is not each.VAR_KEYWORD]
    healthy = {each.name: examples.find(call.name, each) for each in parameters}
    parameters = [each for each in parameters if each.default is each.empty or not rng.integers(3)]
    odd = {parameters[k].name for k in rng.permutation(len(parameters))[: int(rng.choice([0, 1, 1, 1, 2]))]} - {
        "settings"
    }
    arguments: list[Any] = []
    options: dict[str, Any] = {}
    what: list[str] = []
    for each in parameters:
        value = (
            _make_odd(healthy[each.name], rng) if each.name in odd or healthy[each.name] is None else healthy[each.name]
        )
        what.append(f"{each.name}={_show(value)}" if each.name in odd else each.name)
        if each.kind is each.VAR_POSITIONAL:
            arguments += value if isinstance(value, tuple) else [value]
        elif each.kind is each.KEYWORD_ONLY or len(arguments) < parameters.index(each):
            options[each.name] = value
        else:
            arguments.append(value)
    return arguments, options, what


def _signature(call: PublicCall) -> inspect.Signature:
    try:
        return inspect.signature(call.function)
    except ValueError:
        return inspect.Signature()


def _show(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}"
    return f"{type(value).__name__}" if isinstance(value, int) and abs(value) > 10**30 else f"{value!r:.40}"


def _make_odd(healthy: Any, rng: np.random.Generator) -> Any:
    """Something of another type, shape or size, or with other numbers."""
    if not isinstance(healthy, np.ndarray | list | tuple) or not rng.integers(5):
        return _ODD[rng.integers(len(_ODD))]
    try:
        values = np.array(healthy)
    except ValueError:  # of objects
        return _ODD[rng.integers(len(_ODD))]
    match rng.integers(6):
        case 0:
            return np.zeros(_SHAPES[rng.integers(len(_SHAPES))], values.dtype)
        case 1:
            return np.zeros(_LARGE[rng.integers(len(_LARGE))], values.dtype)
        case 2:
            with np.errstate(all="ignore"):
                return values.astype(_TYPES[rng.integers(len(_TYPES))])
        case 3 if values.size:
            number = (np.nan, np.inf, -np.inf, 1e300, -1e300, -1, 2**31 - 1, -(2**31), 10**6)[rng.integers(9)]
            values = values.astype(np.float64) if values.dtype.kind == "f" else values
            with np.errstate(all="ignore"):
                values.flat[rng.integers(values.size)] = np.array(number).astype(values.dtype)
            return values
        case 4:
            return (
                [values[1:], values[..., :-1], values[None], values.T[::-1], np.repeat(values, 2, axis=0)][
                    rng.integers(5)
                ]
                if values.ndim
                else values[None]
            )
        case _:
            return values.tolist()


class Examples(NamedTuple):
    """Healthy arguments by type, and by name."""

    by_type: dict[type, Any]
    by_name: dict[str, Any]

    def find(self, call: str, parameter: inspect.Parameter) -> Any:
        """A healthy argument for a parameter; None where none is known."""
        for name in (f"{call}.{parameter.name}", parameter.name):
            if name in self.by_name:
                return self.by_name[name]
        words = str(parameter.annotation).replace("|", " ").split()
        return next((value for kind, value in self.by_type.items() if kind.__name__ in words), None)


def make_examples(folder: Path) -> Examples:
    """Map a short drive, and keep what it was made of."""
    rng = np.random.default_rng(3)
    world = make_world("rooms", np.random.default_rng(5))
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(beams=60), rng)
    write_csv_log(folder / "api.csv", log.measurements[:60])
    configuration = override(Configuration(), "particles=3")
    result = gridslam.map_log(folder / "api.csv", configuration=configuration)
    slam = gridslam.build(configuration)
    state = gridslam.run(log.measurements[:60], replace(slam, particles=3), rng=np.random.default_rng(1))
    odometry, scan = log.measurements[60]
    assert odometry is not None
    beams = scan.beams(0.0, 30.0)
    known = KnownMap(result.map)
    mcl = MonteCarloLocalization(known)
    believed = gridslam.run(log.measurements[:10], mcl, rng=np.random.default_rng(1), state=mcl.init())
    poses = np.array(state.poses)
    step, report = slam.step(state.snapshot(), odometry, scan, np.random.default_rng(1))
    priors = np.broadcast_to(np.diag([100.0, 100.0, 400.0]), (3, 3, 3)).copy()
    maps = state.maps
    buffer = TransformBuffer()
    buffer.add_quaternion("odom", "base", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    objects: list[Any] = [
        configuration,
        result,
        slam,
        state,
        believed,
        odometry,
        scan,
        scan.geometry,
        beams,
        known,
        mcl,
        report,
        maps,
        world,
        result.trajectory,
        result.map,
        result.graph,
        Evidence(2.0, -0.4, -10.0, 20.0, 2.0),
        ScanBatch.of([beams, beams]),
        NOT_WEIGHED,
        GaussNewton(),
        Pyramid.of(maps, 0),
        CauchyEndPoint(),
        LikelihoodField(),
        Tracker(),
        state.tracker,
        state.ancestry,
        GaussianIncrement.from_std(np.zeros(3), np.full(3, 0.1)),
        configuration.mapper,
        buffer,
        log,
        step.closure_state,
        configuration.loop_closure,
        GaussNewton()(maps, np.arange(3, dtype=np.int32), poses, priors, beams),
        np.random.default_rng(0),
        Ancestry.start(poses),
        gridslam.Session(configuration),
        mcl.configuration,
        *(RobotConfig(), OdometryNoise(), LidarConfig(beams=20)),
    ]
    pose = poses[0].copy()
    weights = np.full(3, 1 / 3)
    by_words = {
        "row particle first best step": 0,
        "rows parents leaves": np.arange(3, dtype=np.int32),
        "poses guesses estimates truths source target frames trajectory": poses,
        "pose guess increment a b xi moved control twist measured mean carried tracked key_pose": pose,
        "priors covariances": priors,
        "prior covariance noise information both": np.diag([0.1, 0.1, 0.1]),
        "points ends": beams.ends.copy(),
        "origin": np.zeros(2),
        "weights likelihoods": weights,
        "log_weights log_odds": np.log(weights),
        "ranges expected": np.full(60, 2.0),
        "count particles most size degrees every threads seed": 3,
        "max_m resolution_m spacing_m clearance_m sigma_m distance_m reach_m min_m finest_m": 0.5,
        "fraction probability confidence error z translation_m rotation_rad effective_sample_size angle most_s": 0.5,
        "stamp_ns tolerance_ns": 10**9,
    }
    rigid = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
    of_rigid = ("compose.a", "compose.b", "inverse.a", "interpolate.a", "interpolate.b", "planar.a", "to_matrix.a")
    names: dict[str, Any] = {
        **{word: value for words, value in by_words.items() for word in words.split()},
        **{f"geometry.rigid.{name}": rigid for name in of_rigid},
        "reach_cells": 3.5,
        "directions": np.column_stack([np.cos(np.arange(5.0)), np.sin(np.arange(5.0))]),
        "distances": np.full((3, 4), 0.2, np.float32),
        "cells": np.zeros((4, 2), np.int64),
        "ids": np.zeros(2, np.int32),
        "std": np.full(3, 0.1),
        "bearings": np.linspace(-1, 1, 60),
        "base_from_laser": np.zeros(3),
        "status": np.zeros(60, np.uint8),
        "arrays": state.maps.to_arrays(),
        "rng": np.random.default_rng(0),
        "map": known,
        "sensor": CauchyEndPoint(),
        "log": folder / "api.csv",
        "path": folder / "api.csv",
        "text": "particles = 3",
        "name": "rooms",
        "xyzw": (0.0, 0.0, 0.0, 1.0),
        "translation": (0.0, 0.0, 0.0),
        "transform": np.eye(4),
        "matrix": np.eye(4),
        "edges": np.array([[0, 1], [1, 2]]),
        "measurements": np.zeros((2, 3)),
        "stamps_ns": np.arange(3) * 10**8,
        "known": np.zeros((2, 2)),
        "nodes": np.zeros((2, 3)),
        "assignments": "particles=3",
        "target_frame": "odom",
        "batch": ScanBatch.of([beams, beams, beams]),
        **dict.fromkeys(("grid.TileMaps.match.settings", "grid.TileMaps.match_pose.settings"), _SETTINGS),
        "grid.TileMaps.match_scans.settings": (*_SETTINGS, 10),
        "gridslam.run.source": list(log.measurements[:3]),
        "gridslam.run.algorithm": slam,
        "gridslam.preset.name": "default",
        "gridslam.map_log.particles": 2,
        "config.apply_laser.name": "hokuyo",
        "particles.Ancestry.extend.poses": poses,
        "gridslam.KnownMap.sample_poses.count": 5,
        "particles.kld_bound.bins": np.arange(3),
        "gridslam.LaserScan.from_rows.ranges": np.full((3, 60), 2.0),
        "gridslam.Odometry.from_rows.poses": poses,
    }
    return Examples({type(each): each for each in objects if each is not None}, names)
