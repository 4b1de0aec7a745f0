"""The node on a transport: its services, and its life from the parameters to the last file."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from functools import partial
from typing import Any, final

import numpy as np

from gridslam.api.mapping import MapResult
from gridslam.errors import ArgumentError, GridslamError, OutputError
from gridslam.io.bags.encoder import MessageError
from gridslam.io.bags.ros_messages import decode_scan, decode_transforms
from gridslam.io.output import OutputFolder
from gridslam.pipeline import describe_error
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.live_autosave import keep_other
from gridslam.ros.node.mapping_session import Session
from gridslam.ros.node.messages import PLANAR, Level
from gridslam.ros.node.outputs import grid_values
from gridslam.ros.node.parameters import NodeParameters
from gridslam.ros.node.transport import ALL_TOPICS, TOPICS, RunOptions, Transport

_POSE = TOPICS["~/pose"]
_SCANS_DEPTH, _TRANSFORMS_DEPTH = 500, 2500  # what a pause of some seconds may hold up


@final
class RosNode:
    """The node on a transport.

    Parameters
    ----------
    transport : Transport
        Carries its messages.
    parameters : NodeParameters
        Settings and configuration from the node's parameters.

    Raises
    ------
    OutputError
        Results or the record cannot be written.
    """

    def __init__(self, transport: Transport, parameters: NodeParameters) -> None:
        if parameters.out is not None:  # before the run rather than after it
            with OutputFolder(parameters.out, MapResult.all_names()):
                pass
        self._transport = transport
        self._out = parameters.out
        self._files = parameters.files
        self.core = NodeCore(
            parameters.settings,
            parameters.configuration,
            transport.outputs,
            record=parameters.record,
            files=parameters.files,
        )
        self._log = self.core.messages.report
        if self._out is not None:
            self.core.results_folder = self._out
        topics = ALL_TOPICS if self.core.localizes else TOPICS
        transport.connect(self.core.refuse_message, {**topics})
        if parameters.warning:
            self._log(Level.WARN, parameters.warning)

    def start(self) -> None:
        """Start the core, services and subscriptions."""
        core = self.core
        core.start()
        self._advertise_services()
        settings = core.settings
        scans, encoder = self._transport.resolve(settings.scan_topic), self._transport.encoder

        def on_transforms(data: bytes, static: bool = False) -> None:
            core.on_transforms(decode_transforms(data, encoder), static=static)

        def on_scan(data: bytes) -> None:
            core.on_scan(decode_scan(data, encoder), scans)

        def on_pose(data: bytes) -> None:
            set_pose_from_message(core, encoder.decode(_POSE, data))

        if core.localizes:
            self._subscribe("initialpose", _POSE, on_pose, depth=1)
        on_static_transforms = partial(on_transforms, static=True)
        self._subscribe("/tf_static", "tf2_msgs/TFMessage", on_static_transforms, latched=True, depth=100)
        self._subscribe("/tf", "tf2_msgs/TFMessage", on_transforms, depth=_TRANSFORMS_DEPTH)
        self._subscribe(settings.scan_topic, "sensor_msgs/LaserScan", on_scan, reliable=False, depth=_SCANS_DEPTH)
        frames = "" if settings.odometry == "none" else f"for {settings.base_frame} in {settings.odom_frame}"
        core.await_input(scans, frames)

    def close(self) -> None:
        """Stop the core, write its map if a folder was given and there is a map, and shut the transport down."""
        try:
            session = self.core.close()
            if session is not None:
                self._write(session)
        finally:
            self._transport.close()

    def _write(self, session: Session) -> None:
        """Write what was mapped: first the session, as a node that takes long to end may be killed."""
        try:
            self._write_session(session)
        finally:
            if self._out is not None:
                self._log(Level.OK, f"writing {session.log.scan_count} scans to {self._out.resolve()}")
                session.save(self._out)

    def _write_session(self, session: Session) -> None:
        save = self._files.save
        if save is None:
            return
        autosave = self._files.autosave
        if autosave != save:
            keep_other(save, session.continued, self._log)
        session.save_session(save)
        self._log(Level.OK, f"session saved: {save.resolve()}")
        if autosave is not None and autosave != save and autosave.exists() and not os.path.samefile(autosave, save):
            autosave.unlink()

    def run(self, options: RunOptions) -> None:
        """Run until the transport or a KeyboardInterrupt ends it; raises GridslamError if the filter failed."""
        core = self.core
        with options.open_viewers(core):
            try:
                self.start()
                for _ in self._transport.spin(core.ended):
                    options.on_poll()
            except KeyboardInterrupt:  # the usual end of a node
                pass
            finally:
                self.close()
        if core.failure is not None:
            raise GridslamError(f"the filter failed: {core.failure}") from core.failure

    def _advertise_services(self) -> None:
        core = self.core
        transport = self._transport

        def reset(request: Any) -> None:  # noqa: ANN401
            core.reset()

        def pause(request: Any) -> tuple[bool, str]:  # noqa: ANN401
            core.pause(request.data)
            return True, "paused" if request.data else "mapping"

        transport.advertise("dynamic_map", "nav_msgs/GetMap", self._give_map, slow=True)
        transport.advertise("~/save", "std_srvs/Trigger", self._save, slow=True)
        transport.advertise("~/pause", "std_srvs/SetBool", pause)
        transport.advertise("~/reset", "std_srvs/Empty", reset)
        if core.localizes:
            transport.advertise(transport.global_localization, "std_srvs/Empty", reset)

    def _save(self, request: Any) -> tuple[bool, str]:  # noqa: ANN401
        """Write what `gridslam map` writes, while mapping goes on; give whether it succeeded, and a message."""
        folder = self.core.results_folder
        try:
            document = self.core.save(folder)
        except GridslamError as error:
            level = Level.ERROR if isinstance(error, OutputError) else Level.WARN
            self._log(level, f"request failed: {error}")
            return False, str(error)
        done = f"results of {document['scans']['read']} scans saved: {folder.resolve()}"
        self._log(Level.OK, done)
        return True, done

    def _give_map(self, request: Any) -> bytes:  # noqa: ANN401
        """Give the response with the map that was published last; raises GridslamError without one."""
        latest = self.core.dynamic_map()
        if latest is None:
            raise GridslamError("there is no map yet")
        encoder = self._transport.encoder
        return encoder.encode(TOPICS["map"], *grid_values(encoder, "dynamic_map", latest))

    def _subscribe(self, topic: str, kind: str, handle: Callable[[bytes], None], **qos: Any) -> None:  # noqa: ANN401
        """Subscribe, and warn of bytes that are not a valid message."""
        name = self._transport.resolve(topic)

        def on_message(data: bytes) -> None:
            try:
                handle(data)
            except Exception as error:  # the transport's thread goes on, whatever the bytes were
                problem = str(error) if isinstance(error, MessageError) else describe_error(error)
                self.core.refuse_message("message", f"{name}: {problem}")

        self._transport.subscribe(topic, kind, on_message, **qos)


def set_pose_from_message(core: NodeCore, message: Any) -> None:  # noqa: ANN401
    """Set the pose of the robot from geometry_msgs/PoseWithCovarianceStamped, as RViz sends it on `initialpose`.

    Raises MessageError if it is not a pose in the node's map.
    """
    frame = message.header.frame_id
    if frame != core.settings.map_frame:
        raise MessageError(f"expected a pose in the frame {core.settings.map_frame}, got {frame!r}")
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    yaw = math.atan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
    covariance = np.asarray(message.pose.covariance, np.float64).reshape(6, 6)[PLANAR]
    try:
        core.set_pose((np.array([place.x, place.y, yaw]), covariance))
    except ArgumentError as error:
        raise MessageError(str(error)) from None
