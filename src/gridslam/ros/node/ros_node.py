"""The node on a transport: its services, and its life from the parameters to the last file."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any, final

from gridslam.api.mapping import MapResult
from gridslam.errors import ArgumentError, ConfigurationError, GridslamError
from gridslam.io.bags.ros_messages import MessageError, Wire, decode_scan, decode_transforms
from gridslam.io.output import OutputFolder
from gridslam.pipeline import describe_error
from gridslam.ros.node.core import NodeCore
from gridslam.ros.node.grid_input import covariance_of, pose_of
from gridslam.ros.node.live_autosave import keep_other
from gridslam.ros.node.mapping_session import SessionCopy
from gridslam.ros.node.messages import Level
from gridslam.ros.node.outputs import grid_values
from gridslam.ros.node.parameters import NodeParameters
from gridslam.ros.node.session_services import SessionServices
from gridslam.ros.node.transport import ALL_TOPICS, TOPICS, RunOptions, Serve, Transport

_POSE = TOPICS["~/pose"]
_PAUSED = "paused_new_measurements"
_SAVE_AS = "save_as"
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
        self._scan_topic = str(parameters.values["scan_topic"])
        self._values = parameters.values
        self._saving: list[threading.Thread] = []
        self._saved: set[Path] = set()
        self.core = NodeCore(
            parameters.settings,
            parameters.configuration,
            transport.outputs,
            record=parameters.record,
            on_jump=None if self._out is None else self._save_earlier,
            files=parameters.files,
        )
        self._log = self.core.messages.report
        if self._out is not None:
            self.core.results_folder = self._out
        self._services = SessionServices(self.core, self.core.results_folder, self._log)
        self._services.save_as = str(parameters.values.get(_SAVE_AS, ""))
        if parameters.values[_PAUSED]:
            self.core.pause(True)
        topics = ALL_TOPICS if self.core.localizes else TOPICS
        transport.connect(self.core.refuse_message, {**topics})
        if parameters.warning:
            self._log(Level.WARN, parameters.warning)

    def start(self) -> None:
        """Start the core, services and subscriptions."""
        core = self.core
        core.start()
        self._advertise_services()
        scans, decode = self._transport.resolve(self._scan_topic), self._transport.encoder.decode

        def on_transforms(data: bytes, wire: Wire, publisher: str, static: bool = False) -> None:
            core.on_transforms(decode_transforms(data, wire), static=static, publisher=publisher)

        def on_scan(data: bytes, wire: Wire, publisher: str) -> None:
            core.on_scan(decode_scan(data, wire), scans)

        def on_pose(data: bytes, wire: Wire, publisher: str) -> None:
            set_pose_from_message(core, decode(_POSE, data))

        if core.localizes:
            self._subscribe("initialpose", _POSE, on_pose, depth=1)
        on_static_transforms = partial(on_transforms, static=True)
        self._subscribe("/tf_static", "tf2_msgs/TFMessage", on_static_transforms, latched=True, depth=100)
        self._subscribe("/tf", "tf2_msgs/TFMessage", on_transforms, depth=_TRANSFORMS_DEPTH)
        self._subscribe(self._scan_topic, "sensor_msgs/LaserScan", on_scan, reliable=False, depth=_SCANS_DEPTH)
        settings = core.settings
        frames = "" if settings.odometry == "none" else f"for {settings.base_frame} in {settings.odom_frame}"
        core.await_input(scans, frames)

    def close(self) -> None:
        """Stop the core, write its map if a folder was given and there is a map, and shut the transport down."""
        try:
            session = self.core.close()
            if session is not None:
                self._write(session)
        finally:
            for thread in self._saving:
                thread.join()
            self._transport.close()

    def _write(self, session: SessionCopy) -> None:
        """Write what was mapped: first the session, as a node that takes long to end may be killed."""
        try:
            self._write_session(session)
        finally:
            if self._out is not None:
                self._log(Level.OK, f"writing {session.log.scan_count} scans to {self._out.resolve()}")
                session.save(self._out)

    def _write_session(self, session: SessionCopy) -> None:
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

    def _save_earlier(self, session: SessionCopy) -> None:
        """Save a session to OUT-1, or the next number that is free, while the next session is mapped."""
        assert self._out is not None
        out = self._out.resolve()
        numbered = (out.with_name(f"{out.name}-{number}") for number in count(1))
        folder = next(path for path in numbered if path not in self._saved and not os.path.lexists(path))
        self._saved.add(folder)

        def save() -> None:
            try:
                self._log(Level.OK, f"writing {session.log.scan_count} scans of the session before to {folder}")
                session.save(folder)
                session.save_session(folder / "session.gridslam")
            except Exception as error:
                self._log(Level.ERROR, f"the session before is not saved: {describe_error(error)}")

        thread = threading.Thread(target=save, name="gridslam-save")
        self._saving.append(thread)
        thread.start()

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

        transport.advertise_parameters(self._values, self._change_parameter, (_PAUSED, _SAVE_AS))
        transport.advertise("dynamic_map", "nav_msgs/GetMap", self._give_map, slow=True)
        taken = self._advertise_slam_toolbox()
        own: dict[str, tuple[str, Serve, bool]] = {
            "~/reset": ("std_srvs/Empty", reset, False),
            "~/pause": ("std_srvs/SetBool", pause, False),
            **{name: (kind, serve, True) for name, (kind, serve) in self._services.standard().items()},
        }
        if core.localizes:
            own |= {
                transport.global_localization: ("std_srvs/Empty", reset, False),
                "request_nomotion_update": ("std_srvs/Empty", lambda request: core.update_once(), False),
            }
        for name, (kind, serve, slow) in own.items():
            if transport.resolve(name) not in taken:
                transport.advertise(name, kind, serve, slow=slow)

    def _advertise_slam_toolbox(self) -> set[str]:
        """Offer slam_toolbox's services where its types are known; returns their full names."""
        offered = set()
        for name, (kind, serve) in self._services.of_slam_toolbox().items():
            with suppress(ConfigurationError):  # ROS is there, but not the package
                self._transport.advertise(name, kind, serve, slow=True)
                offered.add(self._transport.resolve(name))
        return offered

    def _give_map(self, request: Any) -> bytes:  # noqa: ANN401
        """Give the response with the map that was published last; raises GridslamError without one."""
        latest = self.core.dynamic_map()
        if latest is None:
            raise GridslamError("there is no map yet")
        encoder = self._transport.encoder
        return encoder.encode(TOPICS["map"], *grid_values(encoder, "dynamic_map", latest))

    def _change_parameter(self, name: str, value: Any) -> str:  # noqa: ANN401
        """Set a parameter while the node runs."""
        if name == _SAVE_AS:
            if not isinstance(value, str):
                return f"{name}: expected the name of a file, got {value!r}"
            self._services.save_as = value
        else:
            assert name == _PAUSED
            self.core.pause(bool(value))
        return ""

    def _subscribe(self, topic: str, kind: str, handle: Callable[[bytes, Wire, str], None], **qos: Any) -> None:  # noqa: ANN401
        """Subscribe, and warn of bytes that are not a valid message."""
        name = self._transport.resolve(topic)

        def on_message(data: bytes, publisher: str) -> None:
            try:
                handle(data, self._transport.wire_of(data), publisher)
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
    try:
        core.set_pose((pose_of(message.pose.pose), covariance_of(message.pose)))
    except ArgumentError as error:
        raise MessageError(str(error)) from None
