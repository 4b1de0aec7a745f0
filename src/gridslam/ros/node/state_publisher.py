"""Publishing after each scan and by timers."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeAlias, final

import numpy as np

from gridslam.geometry.se2 import compose, inverse
from gridslam.localization import LocalizationReport, MonteCarloState
from gridslam.messages import Messages
from gridslam.observers import Latency
from gridslam.particles import entropy
from gridslam.ros.node.accepted_scan import AcceptedScan
from gridslam.ros.node.measurement_queue import Counts, MeasurementQueue
from gridslam.ros.node.messages import CloudMessage, Diagnostics, Level, Outputs, PoseMessage, StampedTransform
from gridslam.ros.node.node_state import NodeFacts, NodeState, find_state
from gridslam.ros.node.parameters import NodeSettings
from gridslam.ros.node.rendering import MapRenderer
from gridslam.slam.grid_fastslam.state import GridFastSlamState
from gridslam.types import FloatArray, StepReport, describe_duration

Report: TypeAlias = StepReport | LocalizationReport

_MAX_CLOCK_OFFSET_NS = 5_000_000_000
_MAX_LATENCIES = 2000  # the last ones, reported by the diagnostics
_RECENT_S = 2.0
_APART_NS = 1_000
_MAX_SET_BACK_NS = 500_000_000  # a clock that is set back by less is waited for
_MAX_OWN_TRANSFORMS = 1000  # the last published transforms, to recognize them on /tf


@final
class StatePublisher:
    """Observer that publishes pose and transform at each scan, entropy and particles at key scans, and the first map.

    Parameters
    ----------
    settings : NodeSettings
        Frames and rates.
    outputs : Outputs
        The transport.
    renderer : MapRenderer or None
        Renders the map; None if it is known.
    queue : MeasurementQueue
        Provides the counts for the diagnostics.
    messages : Messages
        Of the node: its problems, and each change of its state.

    Attributes
    ----------
    facts : NodeFacts
        Facts of which the node's state is found; those that this does not know are set by others.
    """

    def __init__(
        self,
        settings: NodeSettings,
        outputs: Outputs,
        renderer: MapRenderer | None,
        queue: MeasurementQueue,
        messages: Messages,
    ) -> None:
        self._settings = settings
        self._outputs = outputs
        self._renderer = renderer
        self._queue = queue
        self._messages = messages
        self._lock = threading.Lock()  # the filter's thread and the timer both publish the transform
        self._measurement: AcceptedScan | None = None
        self._report: Report | None = None
        self._key: Report | None = None
        self._mapped_report: Report | None = None
        self._map_from_odom: FloatArray = np.zeros(3)
        self._child = settings.base_frame if settings.odometry == "none" else settings.odom_frame
        self._stamp_ns = 0
        self._own_transforms: dict[StampedTransform, None] = {}  # in order
        self._memory_bytes = 0
        self._arrived_s = 0.0
        self._latencies: deque[float] = deque(maxlen=_MAX_LATENCIES)
        self._logged: NodeState | None = None
        self.facts = NodeFacts()
        self.sessions = 0

    def start_session(self) -> None:
        """Start a new session."""
        self.sessions += 1
        self._report = self._key = self._mapped_report = None

    def set_measurement(self, accepted: AcceptedScan) -> None:
        """Set the measurement of the next report."""
        self._measurement = accepted

    def note_arrival(self, accepted: AcceptedScan) -> None:
        """Note that a scan has come, and compare its clock."""
        self._arrived_s = accepted.arrived_s
        behind_s = (self._outputs.now_ns() - accepted.measurement.scan.stamp_ns) * 1e-9
        if abs(behind_s) * 1e9 > _MAX_CLOCK_OFFSET_NS:
            side = "before" if behind_s > 0 else "after"
            self._messages(
                "clock differs",
                f"scans are stamped {describe_duration(behind_s)} {side} the node's clock: synchronize the"
                " clocks, or set use_sim_time when a log is played",
            )

    def __call__(self, report: Report, state: GridFastSlamState | MonteCarloState, seconds: float) -> None:
        """Publish the report of one scan."""
        accepted = self._measurement
        assert accepted is not None
        outputs = self._outputs
        frame = self._settings.map_frame
        odometry = accepted.measurement.odometry
        with self._lock:
            self._report = report
            if odometry is not None:
                self._map_from_odom = compose(report.pose, inverse(odometry.pose))
            elif self._settings.odometry == "none":
                self._map_from_odom = report.pose
        if self._settings.transform_publish_period_s:
            self.publish_transform()
        outputs.pose(PoseMessage(report.stamp_ns, frame, report.pose, report.covariance))
        if report.log_weights is not None:
            self._key = report
            outputs.entropy(entropy(report.log_weights))
            if isinstance(report, LocalizationReport):
                outputs.updated_pose(PoseMessage(report.stamp_ns, frame, report.pose, report.covariance))
            state_weights = np.exp(state.log_weights)
            outputs.particles(CloudMessage(report.stamp_ns, frame, state.poses, state_weights / state_weights.sum()))
        self._latencies.append(time.perf_counter() - accepted.arrived_s)
        if self._logged is None or self._logged.name == "waiting":
            self.log_state()
        if self._mapped_report is None or not self._settings.map_update_interval_s:
            self.publish_map(state)

    def publish_map(self, state: Any) -> None:  # noqa: ANN401
        """Render and publish the map if it is new and no other map is being rendered; call from the filter's thread."""
        renderer = self._renderer
        report = self._report
        is_mapped = isinstance(state, GridFastSlamState)  # else the map is known
        if renderer is None or not is_mapped or report is None or report is self._mapped_report:
            return
        if renderer.is_idle:
            self._mapped_report = report
            self._memory_bytes = renderer.render(state, report.stamp_ns)

    def publish_transform(self) -> None:
        """Publish the transform from map to odometry, stamped `tf_delay_s` ahead; nothing before the first scan."""
        settings = self._settings
        with self._lock:
            if self._report is None:
                return
            stamp_ns = self._unique_stamp(self._outputs.now_ns() + round(settings.tf_delay_s * 1e9))
            x, y, theta = self._map_from_odom.tolist()
            pose = (x, y, 0.0, 0.0, 0.0, float(np.sin(0.5 * theta)), float(np.cos(0.5 * theta)))
            transform = StampedTransform(stamp_ns, settings.map_frame, self._child, pose)
            self._own_transforms[transform] = None  # before publishing: it may return at once on /tf
            if len(self._own_transforms) > _MAX_OWN_TRANSFORMS:
                del self._own_transforms[next(iter(self._own_transforms))]
            self._outputs.transform(transform)

    def _unique_stamp(self, stamp_ns: int) -> int:
        """Return a stamp; 1 us after the last one if the clock rests: tf2 keeps only the first transform of a stamp.

        In Python tf2 converts stamps to floats, which today are 0.24 us apart.
        """
        last_ns = self._stamp_ns
        was_set_back = stamp_ns < last_ns - _MAX_SET_BACK_NS
        self._stamp_ns = stamp_ns if was_set_back else max(stamp_ns, last_ns + _APART_NS)
        return self._stamp_ns

    def drop_own_transforms(self, transforms: Sequence[StampedTransform]) -> Sequence[StampedTransform]:
        """Remove the transforms of this node; warn of one from elsewhere with the same child."""
        child = self._child
        if not self._settings.transform_publish_period_s or all(one.child != child for one in transforms):
            return transforms
        for transform in transforms:
            if transform.child == child and transform not in self._own_transforms:
                two = f"it publishes {child} in {transform.parent}, and this node publishes it in"
                end = "end one of them (a localization, or the bag itself)"
                self._messages("transform of another node", f"{two} {self._settings.map_frame}: {end}")
        return [one for one in transforms if (one.parent, one.child) != (self._settings.map_frame, child)]

    def diagnostics(self) -> Diagnostics:
        """Return counts, latency, the state, and the latest problem."""
        report = self._report
        state = self._find_state()
        latency = Latency.of(np.array(tuple(self._latencies)))
        values = {"state": state.text} | {name: str(getattr(self._queue.counts, name)) for name in Counts.__slots__}
        values |= {f"{kind}, times": str(times) for kind, times in sorted(self._messages.counts.items())}
        values |= {
            "session": str(self.sessions),
            "latency median, ms": f"{1e3 * latency.median_s:.2f}",
            "latency 99 of 100, ms": f"{1e3 * latency.p99_s:.2f}",
            "latency longest, ms": f"{1e3 * latency.max_s:.2f}",
            "effective particles": "" if self._key is None else f"{self._key.n_eff:.1f}",
            "lost": str(report is not None and report.lost).lower(),
            "maps, MB": f"{self._memory_bytes / 1e6:.1f}",
        }
        problem = "" if state.level else self._messages.latest_problem(_RECENT_S)
        summary = f"{state.text}; {problem}" if problem else state.text
        return Diagnostics(Level.WARN if problem else state.level, summary, values, state.name)

    def log_state(self) -> None:
        """Log the state of the node if it has changed."""
        state = self._find_state()
        with self._lock:
            is_new = state != self._logged
            self._logged = state
        if is_new:
            self._messages.report(state.level, state.text, is_state=True)

    def _find_state(self) -> NodeState:
        """Return the state of the node."""
        report = self._report
        now_s = time.time()
        offset_s = now_s - time.perf_counter()  # the clock may be set while the node runs
        received_s = self._queue.received_s
        localized = report if isinstance(report, LocalizationReport) else None
        facts = replace(
            self.facts,
            now_s=now_s,
            received_s=None if received_s is None else received_s + offset_s,
            accepted_s=None if report is None else self._arrived_s + offset_s,
            missing_transform=self._queue.missing_transform,
            is_paused=self._queue.is_paused,
            localizes=localized is not None,
            lost=report is not None and bool(report.lost),
            looking=localized is not None and localized.looking,
        )
        return find_state(facts)
