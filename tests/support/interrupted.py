"""Nodes whose session ends after a given scan and is continued, in a building that earlier days have mapped."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gridslam
from gridslam.config import override
from gridslam.geometry.se2 import between, compose, inverse
from gridslam.io.csv import write_csv_log
from gridslam.io.measurement import Measurement
from gridslam.io.sessions.session_file import SavedSession, read_session
from gridslam.ros.node.continued import Continued
from gridslam.ros.node.live_autosave import LiveAutosave, SessionFiles
from gridslam.ros.node.mapping_session import Session as NodeSession
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

CONFIG = override(gridslam.Configuration(), "particles=3", "mapper.resolution_m=0.1")
SCANS = 260
"""Of the second day; the robot is found again after about 70 of them, earlier where its pose is given."""
_BEGINS = 60
_DAY_S = 86_400


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
    """Write what earlier days have left: a session of two buildings, and the log of the next day."""
    write_csv_log(folder / "monday.csv", drive()[:450])
    write_csv_log(folder / "annex.csv", drive("random")[:120])
    write_csv_log(folder / "tuesday.csv", moved(drive(seed=2)[_BEGINS : _BEGINS + SCANS]))
    session = gridslam.Session(CONFIG)
    session.add(folder / "monday.csv")
    session.add(folder / "annex.csv", place="elsewhere")
    session.save(folder / "days.gridslam")


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

    The file is the session that the node saves at its end, or the autosave. Returns all that the last one leaves but
    times and the logs, of which each node has one.
    """
    out.mkdir()
    scans = moved(drive(seed=2)[_BEGINS : _BEGINS + SCANS])
    continued = replace(Continued.read(folder / "days.gridslam"), is_elsewhere=True)
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
    told = describe_session(read_session(path))
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
        node.log.count(measurement)
        yield measurement


def _fail(failed: object) -> None:
    pytest.fail(str(failed))
