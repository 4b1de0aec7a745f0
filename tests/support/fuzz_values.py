"""Values that a parser of YAML, TOML or JSON takes for something else than whoever wrote them, or never gets over.

A case is a file, or the arguments of a command, in which one value, or key, is replaced by such a value.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from gridslam.api.amcl import override_configuration, read_amcl
from gridslam.config import Configuration, load, override
from gridslam.io.maps import read_map
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.localization import MonteCarloConfiguration
from gridslam.ros.ros2.arguments import parse_ros_arguments
from support.fuzz_bombs import MAP_YAML
from support.fuzz_commands import Prepare, Read, run_command

_DIGITS = "9" * 5000
HOSTILE: tuple[str, ...] = (
    "0x_", "0x", "0b_", "0b", "0o", "0o8", "_", "+", "-", ".", "1_", "1__0", "+.inf", "-.inf", ".nan", "nan", "inf",
    "-inf", "1e400", "-1e400", "1e-400", _DIGITS, f"-{_DIGITS}", f"0x{'f' * 5000}", f"0b{'1' * 9000}", f"0.{_DIGITS}",
    f"1e{_DIGITS}", "1:" * 200 + "1", "1:" * 3000 + "1", "1:" * 3000 + "1.5", "190:20:30", "190:20:30.15", "08",
    "1,000", "1.2.3", "2001-99-99", "2001-01-01", "0000-01-01", "2001-01-01T99:99:99Z", "2001-01-01 00:00:00 +99:99",
    "07:32:61", "9999-12-31", '!!int ""', '!!int "x"', '!!bool "abc"', "!!float x", "!!timestamp x", "!!binary x",
    "!!null x", "!!set {x, y}", "!!omap [x]", "!!pairs 3", "!!str {a: b}", "!!int [1]", "!!map [1]",
    "!!python/object/apply:os.system [id]", "!<x y", "!foo bar", "!!merge x", '"\\U00110000"', '"\\uD800"', '"\\xZZ"',
    '"\\q"', "'", '"', '"""', "'''", "|", ">", "|99", "\u2028", "\ufeff", "\x7f", "ä" * 500, "a" * 100_000, "y", "on",
    "~", "null", "true", "=", "<<", "?", "- -", "&a", "*a", "&a *a", "%", "@", "`", "#", "---", "...", "[" * 90,
    "[" * 3000, "[" * 90 + "]" * 90, "[" * 150 + "]" * 150, "[" * 3000 + "]" * 3000, "{" * 3000,
    "{a: " * 200 + "1" + "}" * 200, "[[[]]]", "[]", "{}", "{a: 1}", "{a = 1}", "[1, 2, 3]",
    "[" + "1, " * 20_000 + "1]", "&a [*a]", "{<<: 3}", "{? [1, 2] : 3}", "{? {a: b} : c}", "[1, [2, [3]]]",
    "{a = {b = {c = 1}}}", "[{}, {}]", "{kind = 3}", "{kind = [1]}", "{kind = 'none'}",
)  # fmt: skip

_KEYS: tuple[str, ...] = (
    "0x_", "2001-99-99", _DIGITS, "? [1, 2]\n", "<<", "&a b", "[a]", '""', '"\\U00110000"', "a.b.c", "a." * 90 + "a",
    "a." * 5000 + "a", "[" + "a." * 90 + "a]\nb", "[[a]]\nb", "[a]\nb", '"a\\nb"', "ros__parameters", "/**", "kind",
    "amcl", "a" * 100_000, "true", "~",
)  # fmt: skip

_AMCL = (
    "amcl:\n  ros__parameters:\n    max_particles: 2000\n    laser_model_type: likelihood_field\n    alpha1: 0.2\n"
    "    initial_pose: {x: 1.0, y: 2.0, yaw: 0.5}\n    set_initial_pose: true\n    scan_topic: [a, b]\n"
)
_CONFIGURATION = "particles = 10\n\n[motion]\nkind = 'DiffusionMotion'\n\n[tracker]\nmap_scans = 30\n"
_NAMES = (
    "particles", "range_max_m", "loop_closure", "motion", "motion.kind", "sensor.kind", "resampler", "mapper",
    "tracker",
)  # fmt: skip
_AMCL_NAMES = ("max_particles", "laser_model_type", "initial_pose_x", "recovery", "alpha1", "set_initial_pose")


def values(folder: Path) -> Iterator[tuple[str, int, Prepare, Read, float]]:
    """Name, point of the report, the two functions and the weight of each family; a log lies in `folder`/logs."""
    log = folder / "logs" / "log.clf"
    (folder / "map.pgm").write_bytes(b"P5\n2 2\n255\n\x00\xfe\xfe\x00")
    kept = MAP_YAML.replace("map.pgm", str(folder / "map.pgm"))
    for name, text, read, arguments in (
        ("map.yaml", kept, read_map, f"localize {log} --map FILE -o OUT"),
        ("amcl.yaml", _AMCL, _read_parameters, f"localize {log} --map {folder / 'map.yaml'} --config FILE -o OUT"),
        ("run.toml", _CONFIGURATION, load, f"map {log} --config FILE --particles 2 -o OUT"),
    ):
        (folder / name).write_text(text)
        read(folder / name)  # else every case would be refused
        prepare = partial(_write_file, name, text, arguments)
        yield f"values of {name}", 9, prepare, partial(_read_file, name, read), 1.0
    yield "assignments", 9, partial(_write_assignment, log), _read_assignment, 2.0


def _write_file(name: str, text: str, arguments: str, to: Path, rng: np.random.Generator) -> None:
    lines = text.splitlines()
    rows = [row for row, line in enumerate(lines) if re.search(r"[:=] ", line)]
    row = rows[rng.integers(len(rows))]
    match = re.match(r"( *)([^:=]+?)( ?[:=] )(.*)$", lines[row])
    assert match
    indent, key, sign, value = match.groups()
    if rng.integers(5):
        value = HOSTILE[rng.integers(len(HOSTILE))]
    else:
        key = _KEYS[rng.integers(len(_KEYS))]
    lines[row] = f"{indent}{key}{sign}{value}"
    (to / name).write_text("\n".join(lines) + "\n", encoding="utf-8", errors="surrogatepass")
    if rng.integers(10) == 0:
        words = arguments.replace("FILE", str(to / name)).replace("OUT", str(to / "out"))
        (to / "arguments.json").write_text(json.dumps(shlex.split(words)))


def _read_file(name: str, read: Callable[[Path], object], where: Path) -> None:
    if (where / "arguments.json").exists():
        run_command(where)
    else:
        read(where / name)


def _read_parameters(path: Path) -> None:
    parse_ros_arguments(["--ros-args", "--params-file", str(path)], "amcl")
    read_parameter_file(path)
    read_amcl(path)


def _write_assignment(log: Path, to: Path, rng: np.random.Generator) -> None:
    value = HOSTILE[rng.integers(len(HOSTILE))]
    names = _NAMES if rng.integers(2) else _AMCL_NAMES
    name = names[rng.integers(len(names))] if rng.integers(5) else _KEYS[rng.integers(len(_KEYS))]
    assignment = f"{name}={value}".replace("\0", "")
    (to / "assignment.json").write_text(json.dumps([names is _NAMES, assignment]))
    if rng.integers(10) == 0:
        arguments = ["map", str(log), "-o", str(to / "out"), "--particles", "2", "--set", assignment]
        (to / "arguments.json").write_text(json.dumps(arguments))


def _read_assignment(where: Path) -> None:
    is_own, assignment = json.loads((where / "assignment.json").read_text())
    if (where / "arguments.json").exists():
        run_command(where)
    elif is_own:
        override(Configuration(), assignment)
    else:
        override_configuration(MonteCarloConfiguration(), [assignment])
    parse_ros_arguments(["--ros-args", "-p", f"a:={assignment.partition('=')[2] or 'x'}"])
