"""Publishing after each scan and by timers."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Any, TypeAlias, final

import numpy as np

from gridslam.geometry.se2 import compose, inverse
from gridslam.localization import LocalizationReport, MonteCarloState
from gridslam.observers import Latency
from gridslam.ros.accepted import Accepted
from gridslam.ros.complaints import Complaints
from gridslam.ros.intake import Counts, Intake
from gridslam.ros.localization import KnownMapTeller
from gridslam.ros.messages import CloudMessage, Diagnostics, Level, Outputs, PoseMessage, StampedTransform
from gridslam.ros.rendering import MapRenderer
from gridslam.ros.settings import NodeSettings
from gridslam.slam.state import GridFastSlamState
from gridslam.types import FloatArray, StepReport

__all__ = ["Speaker"]

Report: TypeAlias = StepReport | LocalizationReport

_STALE_NS = 5_000_000_000
_LATENCIES = 2000  # the last ones, reported by the diagnostics
_RECENT_S = 2.0
_REPEATED_S = 1.0
_SILENT_S = 5.0
_WAITING = Level.WARN, "waiting for a scan"
_OURS = 1000  # the last transforms that are known again when they come back


@final
class Speaker:
    """Observer that publishes: at each scan pose and transform, at key scans the entropy, and the first map.

    Parameters
    ----------
    settings : NodeSettings
        Frames and rates.
    outputs : Outputs
        The transport.
    renderer : MapRenderer or KnownMapTeller
        Renders the map.
    intake : Intake
        Of the scans, for the diagnostics.
    complain : Complaints
        Called with scans whose clock is not the node's.
    """

    def __init__(
        self,
        settings: NodeSettings,
        outputs: Outputs,
        renderer: MapRenderer | KnownMapTeller,
        intake: Intake,
        complain: Complaints,
    ) -> None:
        self._settings, self._outputs, self._renderer = settings, outputs, renderer
        self._intake, self._complain = intake, complain
        self._lock = threading.Lock()  # of what is published by the filter's thread and by the clock's
        self._accepted: Accepted | None = None
        self._report: Report | None = None
        self._key: Report | None = None
        self._drawn: Report | None = None
        self._map_from_odom: FloatArray = np.zeros(3)
        self._child = settings.base_frame if settings.odometry == "none" else settings.odom_frame
        self._told: tuple[int, Report | None] = -1, None
        self._ours: dict[StampedTransform, None] = {}  # in order
        self._repeat_s = 0.0
        self._memory_bytes = 0
        self._latencies: deque[float] = deque(maxlen=_LATENCIES)
        self._state_told = _WAITING  # by the transport
        self.sessions = 0

    def begin(self) -> None:
        """Begin with a new session."""
        self.sessions += 1
        self._report = self._key = self._drawn = None

    def hears(self, accepted: Accepted) -> None:
        """Set the measurement of the next report."""
        self._accepted = accepted
        behind_s = (self._outputs.now_ns() - accepted.measurement.scan.stamp_ns) * 1e-9
        if abs(behind_s) * 1e9 > _STALE_NS:
            way = "before" if behind_s > 0 else "after"
            self._complain(
                "clock differs", f"scans are stamped {abs(behind_s):.1f} s {way} the node's clock: are the clocks set,"
                " and use_sim_time where a log is played?",
            )  # fmt: skip

    def __call__(self, report: Report, state: GridFastSlamState | MonteCarloState, seconds: float) -> None:
        """Publish the report of one scan."""
        accepted, outputs, frame = self._accepted, self._outputs, self._settings.map_frame
        assert accepted is not None
        odometry = accepted.measurement.odometry
        with self._lock:
            self._report = report
            if odometry is not None:
                self._map_from_odom = compose(report.pose, inverse(odometry.pose))
            elif self._settings.odometry == "none":
                self._map_from_odom = report.pose
        if self._settings.transform_publish_period_s:
            self.tell_transform()
        outputs.pose(PoseMessage(report.stamp_ns, frame, report.pose, report.covariance))
        if report.log_weights is not None:
            self._key = report
            weights = np.exp(report.log_weights)
            outputs.entropy(float(-(weights * report.log_weights)[weights > 0].sum()))
            outputs.particles(CloudMessage(report.stamp_ns, frame, state.poses))
        self._latencies.append(time.perf_counter() - accepted.arrived_s)
        if self._drawn is None or not self._settings.map_update_interval_s:
            self.draw(state)

    def draw(self, state: Any) -> None:  # noqa: ANN401
        """Have the map drawn and published, in the filter's thread; not one that was, nor while another one is."""
        if self._report is not None and self._report is not self._drawn and self._renderer.is_idle:
            self._drawn = self._report
            self._memory_bytes = self._renderer.take(state, self._report.stamp_ns)

    def tell_transform(self) -> None:
        """Publish where the odometry frame lies in the map, stamped `tf_delay_s` ahead; nothing before a first scan."""
        settings = self._settings
        with self._lock:
            if self._report is None:
                return
            stamp_ns = self._outputs.now_ns() + round(settings.tf_delay_s * 1e9)
            now_s = time.monotonic()
            told = stamp_ns, self._report
            if told == self._told and now_s < self._repeat_s:  # a clock at rest: tf warns of repetitions
                return
            self._told, self._repeat_s = told, now_s + _REPEATED_S
            x, y, theta = self._map_from_odom.tolist()
            half = 0.5 * theta
            pose = (x, y, 0.0, 0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
            told_of = StampedTransform(stamp_ns, settings.map_frame, self._child, pose)
            self._ours[told_of] = None  # before it is published: it comes back at once
            if len(self._ours) > _OURS:
                del self._ours[next(iter(self._ours))]
            self._outputs.transform(told_of)

    def others(self, transforms: Sequence[StampedTransform], publisher: str = "") -> Sequence[StampedTransform]:
        """Remove the transforms of this node; warn of one from elsewhere with the same child."""
        child = self._child
        if not self._settings.transform_publish_period_s or all(one.child != child for one in transforms):
            return transforms
        for transform in transforms:
            if transform.child == child and transform not in self._ours:
                told = f"{publisher or 'it'} publishes {child} in {transform.parent}, and this node publishes it in"
                end = "end one of them (a localization, or the bag itself)"
                self._complain("transform of another node", f"{told} {self._settings.map_frame}: {end}")
        return [one for one in transforms if (one.parent, one.child) != (self._settings.map_frame, child)]

    def diagnostics(self) -> Diagnostics:
        """How the node does."""
        counts, report = self._intake.counts, self._report
        latency = Latency.of(np.array(tuple(self._latencies)))
        values = {name: str(getattr(counts, name)) for name in Counts.__slots__}
        values |= {f"{kind}, times": str(times) for kind, times in sorted(self._complain.counts.items())}
        values |= {
            "session": str(self.sessions),
            "latency median, ms": f"{1e3 * latency.median_s:.2f}",
            "latency 99 of 100, ms": f"{1e3 * latency.p99_s:.2f}",
            "latency longest, ms": f"{1e3 * latency.max_s:.2f}",
            "effective particles": "" if self._key is None else f"{self._key.n_eff:.1f}",
            "lost": str(report is not None and report.lost).lower(),
            "maps, MB": f"{self._memory_bytes / 1e6:.1f}",
        }
        problem = self._complain.latest(_RECENT_S)
        return Diagnostics(Level.WARN, problem, values) if problem else Diagnostics(*self._state(), values)

    def tell_state(self) -> None:
        """Log what the node is at, where that has changed."""
        state = self._state()
        if state != self._state_told:
            self._state_told = state
            self._outputs.say(*state)

    def _state(self) -> tuple[Level, str]:
        report, accepted = self._report, self._accepted
        if self._intake.is_paused:
            return Level.OK, "paused"
        if report is None or accepted is None:
            return _WAITING
        if time.perf_counter() - accepted.arrived_s > _SILENT_S:
            return Level.WARN, f"no scan has been taken for {_SILENT_S:g} s"
        maps = isinstance(report, StepReport)
        if report.lost:
            why = "the scan agrees with the map too little" if maps else "it may be elsewhere, or the map is another"
            return Level.WARN, f"lost: {why}"
        return Level.OK, "mapping" if maps else "localizing"
