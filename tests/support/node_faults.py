"""Faults in a node's session: what raises, or what its clocks, disk and terminal do; and what is left of the drive."""

from __future__ import annotations

import errno
import inspect
import json
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridslam.grid.arena import TileArena
from gridslam.io.measurement import Measurement
from gridslam.mapping.occupancy_grid_mapping import OccupancyGridMapping
from gridslam.models.endpoint import CauchyEndPoint
from gridslam.models.motion import DiffusionMotion
from gridslam.particles.ancestry import Ancestry
from gridslam.particles.policies import EffectiveSampleSizeBelow, MotionThreshold
from gridslam.particles.resampling import Systematic
from gridslam.ros.node.accepted_scan import MeasurementBuilder, ScanRecorder
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.mapping_session import Session
from gridslam.ros.node.parameters import node_parameters
from gridslam.ros.node.rendering import MapRenderer
from gridslam.ros.node.ros_node import RosNode
from gridslam.ros.node.state_publisher import StatePublisher
from gridslam.ros.node.transport import NO_OPTIONS
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.slam.full_slam import full_slam
from gridslam.slam.grid_fastslam.map_limit import MapLimit
from gridslam.slam.grid_fastslam.proposals import ScanMatchedProposal
from gridslam.slam.grid_fastslam.report_builder import ReportBuilder
from gridslam.slam.loop_closure.loop_closure import LoopClosure
from gridslam.slam.loop_closure.submap_recognition import SubmapRecognition
from gridslam.tracking.tracker import Tracker
from gridslam.transforms import TransformBuffer
from support.ros_node import LocalTransport, RecordedOutputs, mounting, play, until

SHIFT_NS = 1_700_000_000 * 10**9
BEFORE = 50
"""Scans before the fault."""
AFTER = 40
QUICK = {"particles": 3, "queue": 60.0, "map_update_interval": 0.05, "transform_wait": 10.0}

PARTS = {
    "tracker": (Tracker, "step"),
    "motion model": (DiffusionMotion, "__call__"),
    "measurement model": (CauchyEndPoint, "__call__"),
    "proposal": (ScanMatchedProposal, "__call__"),
    "mapper": (OccupancyGridMapping, "__call__"),
    "memory for tiles": (TileArena, "grow"),
    "resampler": (Systematic, "__call__"),
    "update policy": (MotionThreshold, "__call__"),
    "resampling policy": (EffectiveSampleSizeBelow, "__call__"),
    "limit of the maps": (MapLimit, "__call__"),
    "ancestry": (Ancestry, "extend"),
    "report": (ReportBuilder, "key_scan"),
    "loop closure": (LoopClosure, "__call__"),
    "place recognition": (SubmapRecognition, "search"),
    "conversion of scans": (MeasurementBuilder, "build"),
    "transforms": (TransformBuffer, "planar"),
    "publisher": (StatePublisher, "__call__"),
    "transport: pose": (RecordedOutputs, "pose"),
    "transport: map": (RecordedOutputs, "map"),
    "transport: transform": (RecordedOutputs, "transform"),
    "transport: diagnostics": (RecordedOutputs, "diagnostics"),
    "map renderer": (MapRenderer, "_render"),
    "record": (ScanRecorder, "add"),
    "copy of the session": (Session, "copy"),
    "final refinement": (full_slam, "refine_trajectory"),
}
"""Methods that raise."""

CLOCKS = {"clock set back": -10.0, "clock set forward": 1e6, "stamp from the future": 1e9}
"""Seconds by which the stamps of all later scans jump; of the last one that of one scan alone."""


def make_drive(seed: int = 1) -> list[Measurement]:
    """A drive in rooms."""
    rng = np.random.default_rng(seed)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return list(log.measurements)[: BEFORE + AFTER]


class RunningNode:
    """A node in a thread; `stop` ends it as Ctrl-C does."""

    def __init__(self, **parameters: object) -> None:
        self.transport = LocalTransport()
        self.node = RosNode(self.transport, node_parameters({**QUICK, **parameters}, "default"))
        self.error: Exception | None = None
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.node.core.on_transforms([mounting()], static=True)
        self.thread.start()

    def run(self) -> None:
        try:
            self.node.run(NO_OPTIONS)
        except Exception as error:
            self.error = error

    def play(self, measurements: Sequence[Measurement], *, shift_s: float = 0.0, lost: int = 0) -> None:
        """Play measurements, until all but `lost` of them are taken or refused."""
        counts = self.node.core._queue.counts

        def taken() -> int:
            return counts.accepted + counts.refused

        before = taken()
        shift_ns = SHIFT_NS + round(shift_s * 1e9)
        sent = play(self.node.core, self.transport.outputs, measurements, shift_ns=shift_ns)
        assert until(lambda: taken() >= before + sent - lost), self.transport.outputs.warnings()

    def stop(self) -> str:
        """End the node; returns what it has logged."""
        self.transport.shut_down.set()
        self.thread.join(120)
        assert not self.thread.is_alive()
        return self.transport.outputs.warnings()


def is_prepared(core: NodeCore) -> bool:
    """Whether what earlier drives have left is at hand, for the session that goes on from them."""
    session = core._session
    return session._is_prepared or (session._earlier is not None and session._earlier.is_ready)


def run_fault(name: str, drive: Sequence[Measurement], folder: Path, *, stays: bool) -> dict[str, Any]:
    """Drive, let the fault happen once or from then on, drive on and stop; returns what was saved."""
    fault = _part_fault if name in PARTS else _clock_fault if name in CLOCKS else OTHERS[name]
    with pytest.MonkeyPatch.context() as patch:
        node = RunningNode(out=str(folder / "out"), record=str(folder / "scans.csv"))
        node.play(drive[:BEFORE])
        fault(name, node, drive[BEFORE:], patch, stays)
        log = node.stop()
    document = json.loads((folder / "out" / "run.json").read_text())
    trajectory = (folder / "out" / "trajectory.tum").read_text().splitlines()
    return {
        "saved": len(trajectory),
        "failures": document["failures"],
        "error": None if node.error is None else str(node.error),
        "log": log,
    }


def _part_fault(name: str, node: RunningNode, rest: Sequence[Measurement], patch: Any, stays: bool) -> None:
    owner, method = PARTS[name]
    real = getattr(owner, method)
    raised = threading.Event()

    def failing(*arguments: object, **options: object) -> object:
        if raised.is_set() and not stays:
            return real(*arguments, **options)
        raised.set()
        raise MemoryError if "memory" in name else RuntimeError("injected")

    if name == "copy of the session":  # by the service, while mapping goes on
        with pytest.MonkeyPatch.context() as while_saving:
            while_saving.setattr(owner, method, failing)
            succeeded, _ = node.transport.services["~/save"](None)
            assert not succeeded
    else:
        is_static = isinstance(inspect.getattr_static(owner, method), staticmethod)
        patch.setattr(owner, method, staticmethod(failing) if is_static else failing)
    node.play(rest)


def _clock_fault(name: str, node: RunningNode, rest: Sequence[Measurement], patch: Any, stays: bool) -> None:
    shift_s = CLOCKS[name]
    if name.startswith("stamp"):
        node.play(rest[:1], shift_s=shift_s)
        node.play(rest[1:], lost=len(rest))
    else:
        node.play(rest, shift_s=shift_s, lost=2)


def _fill_disk(name: str, node: RunningNode, rest: Sequence[Measurement], patch: Any, stays: bool) -> None:
    real = ScanRecorder._write

    def full(self: ScanRecorder, line: str) -> None:
        self._file.close()
        self._file = Path("/dev/full").open("wb", buffering=0)  # noqa: SIM115 - the recorder closes it
        real(self, line)

    patch.setattr(ScanRecorder, "_write", full)
    node.play(rest)


def _fail_viewer(name: str, node: RunningNode, rest: Sequence[Measurement], patch: Any, stays: bool) -> None:
    def fail(state: object) -> None:
        raise OSError(errno.EPIPE, "Broken pipe")

    patch.setattr(node.node.core._publisher, "publish_map", fail)
    node.play(rest)


def _fail_picture(name: str, node: RunningNode, rest: Sequence[Measurement], patch: Any, stays: bool) -> None:
    def fail(*arguments: object, **options: object) -> None:
        raise RuntimeError("injected")

    patch.setattr("gridslam.api.mapping.draw_map", fail)
    node.play(rest)


OTHERS: dict[str, Callable[[str, RunningNode, Sequence[Measurement], Any, bool], None]] = {
    "disk full: record": _fill_disk,
    "rendering of the map": _fail_viewer,
    "picture": _fail_picture,
}
"""Other faults."""

FAULTS = [*PARTS, *CLOCKS, *OTHERS]
