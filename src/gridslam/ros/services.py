"""What the transports share: who looks on, the service that saves, and the end."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TypeAlias

from gridslam.errors import GridslamError
from gridslam.io.output import OutputFolder
from gridslam.ros.core import NodeCore
from gridslam.ros.messages import Level

__all__ = ["ViewerOpener", "check_folder", "close_node", "describe_topics", "save_results"]

ViewerOpener: TypeAlias = Callable[[NodeCore], AbstractContextManager[object]]
"""Entered with the core before it is started, and left when it has ended: where those who look on come in."""


def check_folder(out: Path | None) -> None:
    """Raise OutputError where results cannot be written; said now, not when the robot has driven for an hour."""
    if out is not None:
        with OutputFolder(out):
            pass


def describe_topics(scans: str, core: NodeCore) -> str:
    """Tell what a node listens to."""
    base, odom = core.settings.base_frame, core.settings.odom_frame
    return f"waiting for scans on {scans}" + ("" if core.settings.odometry == "none" else f" and for {base} in {odom}")


def save_results(core: NodeCore, folder: Path) -> tuple[bool, str]:
    """Save, and tell whether that went well and what came of it."""
    try:
        document = core.save(folder)
    except GridslamError as error:
        return False, str(error)
    return True, f"{document['scans']['read']} scans: {folder.resolve()}"


def close_node(core: NodeCore, out: Path | None, log: Callable[[Level, str], None]) -> None:
    """End the node; what it has mapped is written to `out`, where that is given and there is anything."""
    session = core.close()
    if out is not None and session is not None:
        log(Level.OK, f"{session.log.scan_count} scans, which are written to {out.resolve()}")
        session.save(out)
