"""Runs of a session that are interrupted after a given scan, as by a kill when it has just been autosaved, and go on."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gridslam
from gridslam.api.autosave import Autosave
from gridslam.config import override
from gridslam.geometry.se2 import between, compose
from gridslam.io.csv import write_csv_log
from gridslam.io.maps import read_map, write_map
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.session_file import SavedSession
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

__all__ = ["SCENARIOS", "SCANS", "contents", "drive", "make_building", "moved", "resume_after", "run_whole"]

CONFIG = override(gridslam.Configuration(), "particles=3", "mapper.resolution_m=0.1")
SCANS = 260
"""Of the second day; the robot is found again after about 70 of them, and after less than 20 where its pose is given."""
_BEGINS = 60
_FILES = ("trajectory.tum", "trajectory.csv", "trajectory_online.tum", "map.pgm", "graph.g2o")
_DAY_S = 86_400


class KilledError(Exception):
    """What ends a run, as a kill would."""


@cache
def drive(kind: str = "rooms", seed: int = 1) -> tuple[Measurement, ...]:
    """What a robot measures on a drive through a small building, each seed with noise of its own."""
    world = make_world(kind, np.random.default_rng(5))
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(beams=90), np.random.default_rng(seed))
    return tuple(log.measurements)


def moved(measurements: Iterable[Measurement], later_s: float = _DAY_S) -> list[Measurement]:
    """The same measurements another day: the odometry begins elsewhere, and the clock goes on."""
    own = list(measurements)
    begin = own[0].odometry.pose
    passed = round(later_s * 1e9)
    return [
        Measurement(
            replace(
                odometry,
                pose=compose(np.array([10.0, 0.0, 2.0]), between(begin, odometry.pose)),
                stamp_ns=odometry.stamp_ns + passed,
            ),
            replace(scan, stamp_ns=scan.stamp_ns + passed),
        )
        for odometry, scan in own
    ]


def make_building(folder: Path) -> None:
    """Write what earlier days have left: a session of two buildings, a map of one, and the log of the next day."""
    write_csv_log(folder / "monday.csv", drive()[:450])
    write_csv_log(folder / "annex.csv", drive("random")[:120])
    write_csv_log(folder / "tuesday.csv", moved(drive(seed=2)[_BEGINS : _BEGINS + SCANS]))
    session = gridslam.Session(CONFIG)
    monday = session.add(folder / "monday.csv")
    write_map(folder / "known.yaml", monday.map)
    session.add(folder / "annex.csv", place="elsewhere")
    session.save(folder / "days.gridslam")


def _continued(folder: Path) -> tuple[gridslam.Session, dict[str, Any]]:
    return gridslam.Session.open(folder / "days.gridslam"), {"place": "elsewhere"}


def _frozen(folder: Path) -> tuple[gridslam.Session, dict[str, Any]]:
    return gridslam.Session.open(folder / "days.gridslam"), {"frozen": True}


def _prior(folder: Path) -> tuple[gridslam.Session, dict[str, Any]]:
    session = gridslam.Session(CONFIG)
    session.add_map(read_map(folder / "known.yaml"))
    return session, {}


def _posed(folder: Path) -> tuple[gridslam.Session, dict[str, Any]]:
    session, _ = _prior(folder)
    odometry = [measurement.odometry.pose for measurement in drive()]
    return session, {"pose": between(odometry[0], odometry[_BEGINS]) + np.array([0.5, -0.5, 0.1])}


SCENARIOS: Mapping[str, Callable[[Path], tuple[gridslam.Session, dict[str, Any]]]] = {
    "continued": _continued,
    "frozen": _frozen,
    "prior": _prior,
    "prior, its pose given": _posed,
}
"""What the second day goes on from: a session, and the options of `Session.add`."""


def run_whole(scenario: str, folder: Path, out: Path, **options: Any) -> tuple[dict[str, Any], int]:  # noqa: ANN401
    """Map the second day; returns what it gives (see `contents`), and after which scan the robot was found."""
    session, own = SCENARIOS[scenario](folder)
    result = session.add(folder / "tuesday.csv", **own, **options)
    found = result.found_again
    assert found is not None
    at = int(np.searchsorted(result.online_trajectory.stamps_ns, found.stamp_ns))
    return contents(session, result, out), at


def resume_after(scan: int, scenario: str, folder: Path, out: Path) -> dict[str, Any]:
    """The same, but killed after `scan` scans, when the run was just autosaved; and the same command again."""
    out.mkdir()
    autosave = Autosave(out / "autosave.gridslam", 3600.0)

    def gate(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        for number, measurement in enumerate(measurements, start=1):
            if number == scan:
                autosave._due_s = -math.inf
            yield measurement
            if number == scan:
                break
        autosave.close()
        raise KilledError

    with pytest.raises(KilledError):
        run_whole(scenario, folder, out, autosave=autosave, gate=gate)
    resumed: list[int] = []
    again = Autosave(out / "autosave.gridslam", 3600.0, on_resume=resumed.append)
    found, _ = run_whole(scenario, folder, out, autosave=again)
    assert resumed == [scan]
    return found


def contents(session: gridslam.Session, result: Any, out: Path) -> dict[str, Any]:  # noqa: ANN401
    """All that a run gives but times: files, what run.json says of drives, scans and closures, and the session."""
    document = result.save(out)
    files = {path.name: path.read_bytes() for path in out.glob("*.tum")} | {
        name: (out / name).read_bytes() for name in (*_FILES, *(path.name for path in out.glob("*.pgm")))
    }
    told = {name: json.dumps(document[name]) for name in ("session", "scans", "loop_closure", "failures", "input")}
    session.save(out / "saved.gridslam")
    return files | told | describe_session(session.saved)


def describe_session(saved: SavedSession) -> dict[str, Any]:
    """All that a session file holds but times."""
    arrays = replace(saved, written="").dump()
    return {
        f"session: {name}": np.asarray(values).tobytes()
        for name, values in arrays.items()
        if "latenc" not in name and "seconds" not in name
    }
