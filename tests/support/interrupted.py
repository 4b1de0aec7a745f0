"""Runs of a session that are interrupted after a given scan, as by a kill right after an autosave, and go on."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gridslam
from gridslam.api.autosave import Autosave
from gridslam.api.beginning import Place
from gridslam.config import override
from gridslam.geometry.se2 import between, compose, inverse
from gridslam.io.csv import write_csv_log
from gridslam.io.maps import read_map, write_map
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.session_file import SavedSession, read_session
from gridslam.ros.node.continued import Continued
from gridslam.ros.node.live_autosave import LiveAutosave, SessionFiles
from gridslam.ros.node.mapping_session import Session as NodeSession
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

__all__ = ["SCANS", "SCENARIOS", "interrupt_amid_an_autosave", "make_building", "resume_after", "run_node", "run_whole"]

CONFIG = override(gridslam.Configuration(), "particles=3", "mapper.resolution_m=0.1")
SCANS = 260
"""Of the second day; the robot is found again after about 70 of them, earlier where its pose is given."""
_BEGINS = 60
CARRIED_AFTER, CARRIED_SCANS = 200, 440
"""Of the log in which the robot is carried: scans before, and in all."""
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


def carry(before: Sequence[Measurement], after: Sequence[Measurement]) -> list[Measurement]:
    """One log of two drives, of which the odometry and the clock know nothing."""
    later_ns = 2 * before[-1].scan.stamp_ns - before[-2].scan.stamp_ns - after[0].scan.stamp_ns
    frame = compose(before[-1].odometry.pose, inverse(after[0].odometry.pose))
    return [
        *before,
        *(
            Measurement(
                replace(odometry, pose=compose(frame, odometry.pose), stamp_ns=odometry.stamp_ns + later_ns),
                replace(scan, stamp_ns=scan.stamp_ns + later_ns),
            )
            for odometry, scan in after
        ),
    ]


def make_building(folder: Path) -> None:
    """Write what earlier days have left: a session of two buildings, a map of one, and the log of the next day."""
    write_csv_log(folder / "monday.csv", drive()[:450])
    write_csv_log(folder / "annex.csv", drive("random")[:120])
    write_csv_log(folder / "tuesday.csv", moved(drive(seed=2)[_BEGINS : _BEGINS + SCANS]))
    write_csv_log(
        folder / "carried.csv", carry(drive()[:CARRIED_AFTER], drive(seed=2)[20 : 20 + CARRIED_SCANS - CARRIED_AFTER])
    )
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


def _carried(folder: Path) -> tuple[gridslam.Session, dict[str, Any]]:
    return gridslam.Session(CONFIG), {"log": "carried.csv"}


SCENARIOS: Mapping[str, Callable[[Path], tuple[gridslam.Session, dict[str, Any]]]] = {
    "continued": _continued,
    "frozen": _frozen,
    "prior": _prior,
    "prior, its pose given": _posed,
    "carried within a log": _carried,
}
"""What the second day goes on from: a session, and the options of `Session.add`."""


def run_whole(scenario: str, folder: Path, out: Path, **options: Any) -> tuple[dict[str, Any], int]:
    """Map the second day; returns what it gives (see `contents`), and after which scan the robot was found."""
    session, own = SCENARIOS[scenario](folder)
    result = session.add(folder / own.pop("log", "tuesday.csv"), **own, **options)
    found = result.found_again
    assert found is not None
    online = result.online_trajectory
    at = result.log.scan_count - len(online) + int(np.searchsorted(online.stamps_ns, found.stamp_ns))
    return contents(session, result, out), at


def resume_after(scan: int, scenario: str, folder: Path, out: Path) -> dict[str, Any]:
    """The same, but killed after `scan` scans, when the run was just autosaved; and the same command again."""
    out.mkdir()
    autosave = Autosave(out / "autosave.gridslam", 3600.0)

    numbers = count(1)  # over all drives

    def gate(measurements: Iterable[Measurement]) -> Iterator[Measurement]:
        for measurement in measurements:
            number = next(numbers)
            if number == scan:
                autosave._due_s = -math.inf
            yield measurement
            if number == scan:
                autosave.close()
                raise KilledError

    with pytest.raises(KilledError):
        run_whole(scenario, folder, out, autosave=autosave, gate=gate)
    resumed: list[int] = []
    again = Autosave(out / "autosave.gridslam", 3600.0, on_resume=resumed.append)
    found, _ = run_whole(scenario, folder, out, autosave=again)
    assert resumed == [scan]
    return found


def contents(session: gridslam.Session, result: Any, out: Path) -> dict[str, Any]:
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


def run_node(folder: Path, out: Path, cuts: Sequence[int] = (), *, autosaved: bool = False) -> dict[str, Any]:
    """Let nodes map the second day, each going on from the file that the one before has left after `cuts` scans.

    The file is that of the service `serialize_map`, or the autosave. Returns all that the last one leaves but times and
    the logs, of which each node has one.
    """
    out.mkdir()
    scans = moved(drive(seed=2)[_BEGINS : _BEGINS + SCANS])
    continued = Continued.read(folder / "days.gridslam", place=Place.ELSEWHERE)
    for begin, end in pairwise((0, *cuts, SCANS)):
        node = NodeSession(continued.saved.configuration, continued.saved.seed, 1, continued)
        node.run(_count(node, scans[begin:end]), [_Waiting(node)], _fail)
        path = out / f"{end}.gridslam"
        if autosaved:
            autosave = LiveAutosave(SessionFiles(autosave=path), lambda level, text: None)
            autosave.save(node, wait=True)
            autosave.close()
        else:
            node.copy(None).save_session(path)
        continued = Continued.read(path)
    told = describe_session(replace(read_session(path), thumbnail=b""))
    del told["session: head"]
    document = node.copy(None, is_last=True).save(out / "out")
    told |= {
        file.name: file.read_bytes() for file in (out / "out").iterdir() if file.suffix in (".tum", ".pgm", ".g2o")
    }
    return told | {"found": document["session"]["found_again"], "apart": document["session"]["apart"]}


class _Waiting:
    """Lets each scan wait until what earlier drives have left is at hand, so that nothing depends on time."""

    def __init__(self, node: NodeSession) -> None:
        self._node = node

    def __call__(self, report: object, state: object, seconds: float) -> None:
        while self._node._earlier is not None and not self._node._earlier.is_ready:
            time.sleep(0.005)


def _count(node: NodeSession, measurements: Iterable[Measurement]) -> Iterator[Measurement]:
    for measurement in measurements:
        node._log.count(measurement)
        yield measurement


def _fail(failed: object) -> None:
    pytest.fail(str(failed))


def interrupt_amid_an_autosave(log: Path, out: Path, number: int, delay_s: float = 0.0) -> bool:
    """Map a log and send a signal `delay_s` after an autosave has begun; returns whether the run was still going on."""
    command = [sys.executable, "-m", "gridslam.cli.main", "map", str(log), "--autosave", "0.0001", "--restart", "-o"]
    process = subprocess.Popen([*command, str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while process.poll() is None and not list(out.glob(".autosave.gridslam.*.partial")):
        time.sleep(0.001)
    time.sleep(delay_s)
    process.send_signal(number)
    return process.wait() == 130
